"""The nominal cell, as tests ask what lies where."""

from xray_drake.cell.cell import Cell

CELL = Cell()
BIN, TOTE = CELL.bin, CELL.placed_tote
