"""Tables for a terminal."""

from rover_runtime.text_output import text_table

ROWS = [["", "topic", "count"], ["*", "a", "12"], ["", "bcd/efg", "3"]]


def test_columns_are_aligned_and_lines_end_with_text():
    lines = ["   topic    count", "*  a           12", "   bcd/efg      3"]
    assert text_table(ROWS, left=(0, 1)) == lines
    assert text_table([["a", ""], ["", ""]]) == ["a", ""]
