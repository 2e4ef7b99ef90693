#!/usr/bin/env bash
# Compare the bits of short runs (bits.py) on an emulated processor of another kind: aarch64.sh FOLDER [WORD ...]
#
# FOLDER gets a Python for aarch64: Debian's, and from PyPI the packages that training imports, at the versions
# of .venv (700 MB). It is kept for the next time, as is what numba compiles. qemu runs it, 10 to 40 times as
# slowly as this machine's own. Needs Debian 12 and root, as it installs qemu-user-static.
set -euo pipefail
folder=$(mkdir -p "$1" && cd "$1" && pwd)
shift
cd "$(dirname "$0")/.."
python=.venv/bin/python
packages=(
    numpy numba llvmlite gymnasium cloudpickle farama-notifications typing_extensions pydantic pydantic_core
    annotated-types typing-inspection scipy safetensors
)
debs=(
    python3.11 python3.11-minimal libpython3.11-minimal libpython3.11-stdlib libc6 libgcc-s1 libstdc++6 libgomp1
    zlib1g libexpat1 libssl3 libffi8 libbz2-1.0 liblzma5 libsqlite3-0 libuuid1 libcrypt1 libatomic1
)

set_up() {
    rm -rf "$folder"/{debs,root,site,wheels}
    mkdir "$folder"/{debs,root,site,wheels}
    dpkg --add-architecture arm64
    apt-get -qq update
    apt-get -qq install --yes --no-install-recommends qemu-user-static >/dev/null
    # apt gives up root to write here, and warns that it cannot
    (cd "$folder/debs" && apt-get -qq download "${debs[@]/%/:arm64}" 2>/dev/null)
    for deb in "$folder"/debs/*.deb; do dpkg-deb -x "$deb" "$folder/root"; done
    $python -m pip download --quiet --no-deps --only-binary=:all: --dest "$folder/wheels" \
        --python-version 311 --implementation cp --abi cp311 --abi abi3 --abi none \
        --platform manylinux_2_28_aarch64 --platform manylinux_2_27_aarch64 --platform manylinux_2_17_aarch64 \
        --platform manylinux2014_aarch64 $pins
    for wheel in "$folder"/wheels/*.whl; do $python -m zipfile -e "$wheel" "$folder/site"; done
    echo "$pins" >"$folder/packages.txt"
}

pins=$($python -c 'import importlib.metadata as m, sys; print(*(f"{p}=={m.version(p)}" for p in sys.argv[1:]))' "${packages[@]}")
[ "$pins" = "$(cat "$folder/packages.txt" 2>/dev/null)" ] || set_up
exec qemu-aarch64-static -L "$folder/root" -E "PYTHONPATH=$folder/site:$PWD" -E "NUMBA_CACHE_DIR=$folder/cache" \
    -E "PYTHONPYCACHEPREFIX=$folder/bytecode" "$folder/root/usr/bin/python3.11" -m tests.bits "$@"
