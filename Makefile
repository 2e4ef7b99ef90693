# Two commands do everything: `make study` runs the main job, `make test` checks the code.
# Both set up .venv first, at the versions that constraints.txt pins.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
TESTED := .venv/.tested
# PyTorch's build: cpu, or cu130 and others as uv names them; `default` is that of pip's index, which may bring CUDA.
TORCH ?= cpu
UV := build/uv/bin/uv
# Byte-compiling all that is installed, 2 GB, takes longer than to do so with what is imported.
PIP = $(BIN)/pip install --quiet --disable-pip-version-check --no-compile
# uv is faster, and finds PyTorch's builds; pip installs where uv cannot be had, or does not reach an index.
INSTALL = $(UV) pip install --quiet --python .venv $(1) || $(PIP) $(1)
HASHED = --no-deps --require-hashes --requirement
OWN = --no-build-isolation --constraint constraints.txt --editable
BACKEND = $(filter-out --torch-backend=default,--torch-backend=$(TORCH))

.PHONY: help install constraints study figures docs test storm mutants test-all release-check slow-0 slow-1 slow-2 lint clean
.PHONY: reproduction reproduction-rest reproduction-causes reproduction-winners reproduction-slow
.PHONY: tuning tuning-optimizers tuning-algorithms aarch64

help:            ## Say what each target does
	@grep -E '^[a-z0-9-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/ \t/' | expand -t 24

install: $(INSTALLED)  ## Build .venv with what studies need

# At its end the byte code of pip leaves, 8 MB.
$(INSTALLED): pyproject.toml constraints.txt hashes.txt hashes-uv.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else "Pneuma needs Python 3.11 to 3.13; this is %d.%d. Name another: make PYTHON=python3.12 ..." % v)'
	$(PYTHON) -m venv .venv
	$(PIP) --upgrade --target build/uv $(HASHED) hashes-uv.txt || echo "uv cannot be had: pip installs all"
	$(call INSTALL,$(HASHED) hashes.txt)
	$(UV) pip install --quiet --python .venv $(BACKEND) --constraint constraints.txt torch || \
	    { echo "Taking PyTorch from pip's index, which may bring CUDA"; $(PIP) --constraint constraints.txt torch; }
	$(call INSTALL,$(OWN) .)
	$(BIN)/python -m compileall -q pneuma
	@find .venv -path '*/pip/*' -name __pycache__ -prune -exec rm -r {} +
	@touch $@

$(TESTED): $(INSTALLED) hashes-dev.txt
	$(call INSTALL,$(HASHED) hashes-dev.txt)
	$(call INSTALL,$(OWN) '.[dev]')
	@touch $@

PINS = --constraint constraints.txt
COMPILE = $(UV) pip compile --quiet --universal --upgrade --no-annotate --no-header

# uv asks the index for all files of a version. Constraints with markers make it look for CUDA on machines that have none.
constraints: $(TESTED)  ## Write constraints.txt and hashes anew; PINS= takes the newest versions
	echo uv | $(COMPILE) --python-version 3.11.5 --generate-hashes - --output-file build/uv.txt
	$(COMPILE) --python-version 3.11.5 --extra dev --generate-hashes $(PINS) pyproject.toml --output-file build/all.txt
	grep -o '^[^ ]*==[^ ]*' build/all.txt > build/versions.txt
	echo setuptools | $(COMPILE) --python-version 3.11.5 --constraint build/versions.txt pyproject.toml - --output-file build/run.txt
	.ci/pins build/all.txt build/run.txt build/uv.txt

study: install  ## Run the activation study (thesis Fig. 6.5) at its quick preset, and draw it
	$(BIN)/pneuma study run activation
	$(BIN)/pneuma study plot activation

figures: install  ## Draw everything in paper_figures/, and write the tables that pages hold
	$(BIN)/python -m tools.figures
	$(BIN)/python -m tools.pages

# --- The reproduction ---------------------------------------------------------------------------
#
# Stopped at any moment, each target goes on where it was. In place of `run`, DO takes any command on a study's
# runs, and ARGS its options: `make reproduction DO=plan` tells how long it takes, DO=publish writes the tables to
# commit, and `make reproduction ARGS="--studies clip-range --seeds 2 --steps 4096"` is a quick look.

REPRODUCE = $(BIN)/python studies/scripts/reproduce.py

reproduction: install  ## Train chapter 6's small networks: mostly 30 seeds of 1M steps, in two worlds
	$(REPRODUCE) small-networks $(DO) $(ARGS)

reproduction-slow: install  ## Train chapter 6's mid and big networks
	$(REPRODUCE) other-networks $(DO) $(ARGS)

reproduction-rest: install  ## Train chapters 3 to 5, and the published logs again
	$(REPRODUCE) other-chapters $(DO) $(ARGS)

reproduction-causes: install  ## Train the studies of collapse and other causes
	$(REPRODUCE) causes $(DO) $(ARGS)

reproduction-winners: install  ## Train what searches found on fresh seeds, and the steps that lead there
	$(REPRODUCE) winners $(DO) $(ARGS)

RIVALS_optimizers = adam l2 upgd sgd momentum rmsprop
RIVALS_algorithms = ppo trpo a2c dqn double-dqn

tuning: tuning-optimizers tuning-algorithms  ## Tune optimizers and algorithms alike, and train the winners on fresh seeds

# The studies have the winners, which the same search finds again.
tuning-optimizers tuning-algorithms: tuning-%: install
	for name in $(RIVALS_$*); do $(BIN)/pneuma search run tune-$$name --preset paper || exit; done
	$(BIN)/pneuma study run tuned-$* --preset paper

docs: $(TESTED)  ## Build the pages of docs/ as a site in site/, with all commands and modules; broken links are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

test: lint  ## Check style and types, and run the fast tests
	$(BIN)/python -m pytest -n auto --dist loadfile

storm: $(TESTED)  ## Kill and damage studies at random, and compare every bit
	$(BIN)/python -m tests.training.storm

mutants: $(TESTED)  ## Break the code in some seventy ways, one by one, in a copy; a test must notice each
	$(BIN)/python -m tests.mutants

AARCH64 = build/aarch64

aarch64: $(TESTED)  ## Compare the bits of short runs on an emulated aarch64 processor (root on Debian 12; 700 MB in AARCH64)
	tests/aarch64.sh $(AARCH64)

test-all: test docs release-check slow-0 slow-1 slow-2  ## The same, then the slow tests, links of pages, and archives

# The slow tests in three parts; .ci/run runs one of them, by the day of the year.
SLOW_0 = tests/test_*.py tests/env tests/figures
SLOW_1 = tests/engines tests/search
SLOW_2 = tests/study tests/store tests/training

slow-0 slow-1 slow-2: slow-%: $(TESTED)
	$(BIN)/python -m pytest -m slow $(SLOW_$*)

release-check: $(TESTED)  ## Build wheel and source archive in dist/, and try the wheel in an environment of its own
	.ci/release

lint: $(TESTED)  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:           ## Remove what was built; results stay
	rm -rf .venv build dist site *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
