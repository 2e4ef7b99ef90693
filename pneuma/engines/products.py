"""Products of matrices, sums of squares and transposition, compiled: each number is summed in one order.

Products and sums are fused multiply-adds: rounded once, as IEEE 754 defines it, so that every processor has
the same bits. (One without such instructions calls the C library's `fmaf`, which is slow.) How many numbers
are computed at once is chosen by the processor, and is never part of a bit.
"""

from __future__ import annotations

import platform
from typing import Any

from llvmlite import binding, ir
from numba.core import types

from pneuma.env.compiling import (
    cached,
    target_features,
    typed_arrays,
    typed_codegen,
    typed_double,
    typed_intrinsic,
    typed_pointer,
    typed_void,
)
from pneuma.env.compiling import kernel as inner

COLUMNS = 16
"""Columns of a matrix that lie together: a panel."""


def _tile_shape() -> tuple[int, int]:
    """Return how many rows and panels a tile has, so that its sums fit into the registers of a processor.

    Measured with AVX-512 and AVX2.
    """
    features = target_features()
    if "+avx512f" in features:
        return 8, 2
    if platform.machine() == "aarch64" or "+avx2" in features:
        return 6, 1
    return 2, 1


TILE_ROWS, TILE_PANELS = _tile_shape()
FEW_ROWS = 4


def _tile(rows: int, panels: int, reads_across: bool) -> Any:
    """Return a function that writes a tile of a product, from a row and a panel on.

    The sums stay in registers, which a loop that numba compiles cannot ask for. LLVM divides vectors of
    `COLUMNS` numbers into those that the processor has. Products and sums are fused, that is rounded once,
    which IEEE 754 defines.
    """
    vector = ir.VectorType(ir.FloatType(), COLUMNS)
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), COLUMNS), None)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        row, panel, operands = arguments
        (
            a, a_start, a_distance, a_blocks, a_block, steps, b, b_start, b_panel, b_step,
            first, first_start, first_panel, c, c_start, c_panel, c_row,
        ) = typed_codegen.unpack_tuple(builder, operands)  # fmt: skip
        one = a_distance.type(1)
        a_row, a_step = (one, a_distance) if reads_across else (a_distance, one)

        def vector_at(pointer: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(pointer, [index]), vector.as_pointer())

        def moved(start: Any, distance: Any, times: Any) -> Any:
            return builder.add(start, builder.mul(distance, times))

        def starts(start: Any, distance: Any, first_index: Any, count: int) -> list[Any]:
            start = moved(start, distance, first_index)
            return [moved(start, distance, distance.type(number)) for number in range(count)]

        fused_type = ir.FunctionType(vector, [vector, vector, vector])
        fused = typed_codegen.get_or_insert_function(builder.module, fused_type, f"llvm.fma.v{COLUMNS}f32")
        sums = []
        for panel_start in starts(first_start, first_panel, panel, panels):
            begin = builder.load(vector_at(first, panel_start), align=4)
            sums.append([typed_codegen.alloca_once_value(builder, begin) for _ in range(rows)])
        row_starts, panel_starts = starts(a_start, a_row, row, rows), starts(b_start, b_panel, panel, panels)
        with typed_codegen.for_range(builder, a_blocks) as blocks:
            block_start = builder.mul(blocks.index, a_block)
            first_step = builder.mul(blocks.index, steps)
            with typed_codegen.for_range(builder, steps) as loop:
                step = builder.add(first_step, loop.index)
                factors = []
                for panel_start in panel_starts:
                    factors.append(builder.load(vector_at(b, moved(panel_start, b_step, step)), align=4))
                offset = moved(block_start, a_step, loop.index)
                for number, row_start in enumerate(row_starts):
                    value = builder.load(builder.gep(a, [builder.add(row_start, offset)]))
                    single = builder.insert_element(vector(ir.Undefined), value, ir.IntType(32)(0))
                    values = builder.shuffle_vector(single, single, everywhere)
                    for factor, panel_sums in zip(factors, sums, strict=True):
                        total = panel_sums[number]
                        builder.store(builder.call(fused, [values, factor, builder.load(total)]), total)
        for panel_start, panel_sums in zip(starts(c_start, c_panel, panel, panels), sums, strict=True):
            for row_start, total in zip(starts(panel_start, c_row, row, rows), panel_sums, strict=True):
                builder.store(builder.load(total), vector_at(c, row_start), align=4)
        return context.get_dummy_value()

    @typed_intrinsic
    def tile(typing: Any, row: Any, panel: Any, operands: Any) -> Any:
        return typed_void(row, panel, operands), generate

    return tile


def _product(reads_across: bool) -> Any:
    """Return the Python function of `multiply`, or `multiply_across`."""
    whole_tile, one_panel = _tile(TILE_ROWS, TILE_PANELS, reads_across), _tile(TILE_ROWS, 1, reads_across)
    few_rows, one_row = _tile(FEW_ROWS, 1, reads_across), _tile(1, 1, reads_across)

    def product(
        rows: int, panels: int,
        a: Any, a_start: int, a_distance: int, a_blocks: int, a_block: int, steps: int,
        b: Any, b_start: int, b_panel: int, b_step: int, first: Any, first_start: int, first_panel: int,
        c: Any, c_start: int, c_panel: int, c_row: int, left_once: bool,
    ) -> None:  # fmt: skip
        tile_rows = TILE_ROWS if rows >= TILE_ROWS else FEW_ROWS if rows >= FEW_ROWS else 1
        tile_panels = TILE_PANELS if panels >= TILE_PANELS and tile_rows == TILE_ROWS else 1
        row_tiles, panel_tiles = -(-rows // tile_rows), -(-panels // tile_panels)
        operands = (
            a, a_start, a_distance, a_blocks, a_block, steps, b, b_start, b_panel, b_step,
            first, first_start, first_panel, c, c_start, c_panel, c_row,
        )  # fmt: skip
        for index in range(row_tiles * panel_tiles):
            if left_once:
                row_tile, panel_tile = index // panel_tiles, index % panel_tiles
            else:
                row_tile, panel_tile = index % row_tiles, index // row_tiles
            # the last tile ends with the last row or panel: what two tiles share has the same bits in both
            row = min(row_tile * tile_rows, rows - tile_rows)
            panel = min(panel_tile * tile_panels, panels - tile_panels)
            if tile_panels > 1:
                whole_tile(row, panel, operands)
            elif tile_rows == TILE_ROWS:
                one_panel(row, panel, operands)
            elif tile_rows == FEW_ROWS:
                few_rows(row, panel, operands)
            else:
                one_row(row, panel, operands)

    return product


def _compiled_product(symbol: str, product: Any) -> Any:
    """Compile or load a product; return it for compiled functions, which call it by its symbol.

    Inlined it would be compiled again with each of them.
    """
    matrix, number = typed_pointer(types.float32), types.int64
    signature = types.void(
        number, number, matrix, number, number, number, number, number, matrix, number, number, number,
        matrix, number, number, matrix, number, number, number, types.boolean,
    )  # fmt: skip
    compile_product = cached(signature, error_model="numpy", _nrt=False)
    binding.add_symbol(symbol, compile_product(product).address)
    return types.ExternalFunction(symbol, signature)


multiply = _compiled_product("pneuma_multiply", _product(reads_across=False))
multiply_across = _compiled_product("pneuma_multiply_across", _product(reads_across=True))
"""Write a product of matrices, panel by panel of `COLUMNS` columns, each number summed in one order.

All matrices lie in one-dimensional arrays, which are given by `array.ctypes`. With k = block * steps + step:

    c[panel, row, 0:16] = first[panel, 0:16] + sum over blocks, steps of a[row, k] * b[panel, k, 0:16]

`multiply` reads a left factor whose numbers of a row lie side by side, `multiply_across` one whose numbers of
a column do: the compiled code of one for both would be slower.

Args:
    rows, panels: of the product.
    a, a_start, a_distance, a_blocks, a_block, steps: the left factor, in blocks of so many steps; the
        distances between its rows (across: its columns), and its blocks.
    b, b_start, b_panel, b_step: the right factor; the distances between its panels, and its rows.
    first, first_start, first_panel: what the sums begin with, such as biases.
    c, c_start, c_panel, c_row: the product.
    left_once: whether the left factor is read once and the right one again for each tile of its rows, which
        is faster where the left one is large; else the other way round.
"""


SPAN = 64
"""Numbers that `sum_of_squares` adds at once: as many sums, in an order that no processor changes."""


@inner
def square_of_norm(numbers: Any) -> float:
    """Return the square of the L2 norm of numbers, whose count is a multiple of `COLUMNS`."""
    total = 0.0
    for first in range(0, len(numbers), SPAN * SPAN):
        stop = min(first + SPAN * SPAN, len(numbers))
        whole = (stop - first) // SPAN * SPAN
        total += _sum_of_squares(numbers, first, whole // SPAN)
        for i in range(first + whole, stop):
            total += numbers[i] * numbers[i]
    return total


@typed_intrinsic
def _sum_of_squares(typing: Any, numbers: Any, start: Any, spans: Any) -> Any:
    """Return the sum of the squares of so many spans of `SPAN` numbers."""
    vector = ir.VectorType(ir.FloatType(), COLUMNS)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers, start, spans = arguments
        data = typed_arrays.make_array(signature.args[0])(context, builder, numbers).data
        zeros = ir.Constant(vector, [0.0] * COLUMNS)
        sums = [typed_codegen.alloca_once_value(builder, zeros) for _ in range(SPAN // COLUMNS)]
        with typed_codegen.for_range(builder, spans) as loop:
            span_start = builder.add(start, builder.mul(loop.index, start.type(SPAN)))
            for number, total in enumerate(sums):
                index = builder.add(span_start, start.type(number * COLUMNS))
                pointer = builder.bitcast(builder.gep(data, [index]), vector.as_pointer())
                factor = builder.load(pointer, align=4)
                builder.store(builder.fadd(builder.load(total), builder.fmul(factor, factor)), total)
        total = ir.Constant(ir.DoubleType(), 0.0)
        for vector_sum in sums:
            lanes = builder.load(vector_sum)
            for lane in range(COLUMNS):
                number = builder.extract_element(lanes, ir.IntType(32)(lane))
                total = builder.fadd(total, builder.fpext(number, ir.DoubleType()))
        return total

    return typed_double(numbers, start, spans), generate


@inner
def transpose(a: Any, row_blocks: int, column_blocks: int, a_row: int, b: Any, b_row: int) -> None:
    """Write the rows of `a` as columns of `b`, in blocks of `COLUMNS` rows and columns."""
    for row in range(0, row_blocks * COLUMNS, COLUMNS):
        for column in range(0, column_blocks * COLUMNS, COLUMNS):
            _transpose_block(a, row * a_row + column, a_row, b, column * b_row + row, b_row)


@typed_intrinsic
def _transpose_block(typing: Any, a: Any, a_start: Any, a_row: Any, b: Any, b_start: Any, b_row: Any) -> Any:
    """Transpose a block of `COLUMNS` rows and columns in registers (Eklundh 1972)."""
    vector = ir.VectorType(ir.FloatType(), COLUMNS)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, a_start, a_row, b, b_start, b_row = arguments

        def pointers(position: int, value: Any, start: Any, distance: Any) -> list[Any]:
            data = typed_arrays.make_array(signature.args[position])(context, builder, value).data
            row_pointers = []
            for row in range(COLUMNS):
                index = builder.add(start, builder.mul(distance, distance.type(row)))
                row_pointers.append(builder.bitcast(builder.gep(data, [index]), vector.as_pointer()))
            return row_pointers

        def shuffled(left: Any, right: Any, lanes: list[int]) -> Any:
            mask = ir.Constant(ir.VectorType(ir.IntType(32), COLUMNS), lanes)
            return builder.shuffle_vector(left, right, mask)

        rows = [builder.load(pointer, align=4) for pointer in pointers(0, a, a_start, a_row)]
        distance = 1
        while distance < COLUMNS:  # swap the off-diagonal quarters of ever larger squares
            # lanes from COLUMNS on are those of the second vector
            upper = [lane if not lane & distance else lane - distance + COLUMNS for lane in range(COLUMNS)]
            lower = [lane + distance if not lane & distance else lane + COLUMNS for lane in range(COLUMNS)]
            for row in range(COLUMNS):
                if not row & distance:
                    pair = rows[row], rows[row + distance]
                    rows[row], rows[row + distance] = shuffled(*pair, upper), shuffled(*pair, lower)
            distance *= 2
        for row, pointer in zip(rows, pointers(3, b, b_start, b_row), strict=True):
            builder.store(row, pointer, align=4)
        return context.get_dummy_value()

    return typed_void(a, a_start, a_row, b, b_start, b_row), generate
