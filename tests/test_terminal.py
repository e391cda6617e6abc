"""Tables on the terminal show every cell as it is."""

from __future__ import annotations

from rich.text import Text

from speckle_mi.report.terminal import MACHINE, print_machine, print_table, terminal

HEADS = ("what", "value", "note")


def lines_of(capsys) -> list[str]:
    return [line.rstrip() for line in capsys.readouterr().out.splitlines() if line.strip()]


def test_cells_stand_under_their_heads_words_left_and_numbers_right(capsys):
    print_table(terminal(), HEADS, [["a", "1", "x"], ["bb", "22.5", "y"]], title="Title", left=(0, 2))
    title, heads, _, first, second = lines_of(capsys)
    assert title == "Title" and heads.split() == list(HEADS)
    assert first.index("a") == second.index("bb") == heads.index("what")
    assert first.index("1") + 1 == second.index("22.5") + 4 == heads.index("value") + 5


def test_brackets_are_text_and_not_markup(capsys):
    print_table(terminal(), HEADS, [["angle [rad]", "[1, 2]", Text("[bold]", "red")]], title="units [mm]")
    text = "\n".join(lines_of(capsys))
    assert all(word in text for word in ("angle [rad]", "[1, 2]", "[bold]", "units [mm]"))


def test_a_long_cell_is_folded_and_not_cut(capsys):
    words = " ".join(f"word{number}" for number in range(60))
    print_table(terminal(), HEADS, [["a", "1", words]], left=(0, 2))
    shown = " ".join(lines_of(capsys)).split()
    assert all(word in shown for word in words.split())


def test_rows_of_one_group_stand_together(capsys):
    print_table(terminal(), HEADS, [["1", "a", ""], ["1", "b", ""], ["2", "c"]], group_by=0)
    text = [line.strip() for line in capsys.readouterr().out.splitlines()]
    rule = next(number for number, line in enumerate(text) if line.startswith("─"))
    first, second, gap, third = text[rule + 1 : rule + 5]
    assert [first.split(), second.split(), gap, third.split()] == [["1", "a"], ["1", "b"], "", ["2", "c"]]


def test_quiet_prints_nothing(capsys):
    print_table(terminal(quiet=True), HEADS, [["a", "1", "x"]])
    assert capsys.readouterr().out == ""


def test_the_machine_is_one_line_of_what_is_known(capsys):
    print_machine(terminal(), {"cores": "2", "numpy": "2.0", "user": "me"})
    assert lines_of(capsys) == ["machine: cores 2, numpy 2.0"] and "cores" in MACHINE
