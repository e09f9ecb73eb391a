"""The table of our numbers and the paper's: as text, as HTML without styles, as Markdown."""

from __future__ import annotations

import html.parser
import math

import pytest

from tutorial_lib.errors import TutorialError
from tutorial_lib.view import error_table

COLUMNS = ["80 ms", "400 ms"]
OURS = {"Walking": {"LSTM-3LR": [0.5, 2.0], "acLSTM": [0.62, 1.504]}, "Dance": {"acLSTM": [0.7, math.nan]}}
PAPER = {"Walking": {"LSTM-3LR": [2.46, 2.41], "ERD": ["0.135", 0.71]}}


class Cells(html.parser.HTMLParser):
    """A table's rows of (text, whether it is bold)."""

    def __init__(self, source: str):
        super().__init__()
        self.rows, self.bold, self.tags, self.attributes, self.caption = [], False, set(), set(), ""
        self.feed(source)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attributes}
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append(("", False))
        elif tag == "b":
            self.bold = True

    def handle_endtag(self, tag):
        self.bold = self.bold and tag != "b"

    def handle_data(self, data):
        if self.rows:
            self.rows[-1][-1] = (self.rows[-1][-1][0] + data, self.bold)
        else:
            self.caption += data


def test_text_for_a_terminal():
    table = error_table(COLUMNS, OURS, PAPER, caption="Prediction error", unit="m")
    assert str(table) == repr(table)
    assert str(table).splitlines() == [
        "Prediction error (m)",
        "                    80 ms  400 ms",
        "Walking",
        "  LSTM-3LR  ours    *0.50    2.00",
        "            paper    2.46    2.41",
        "  acLSTM    ours     0.62   *1.50",
        "  ERD       paper  *0.135   *0.71",
        "Dance",
        "  acLSTM    ours     0.70       –",
        "* the best of its column",
    ]


def test_html_says_it_all_in_plain_tags():
    found = Cells(error_table(COLUMNS, OURS, PAPER, caption="Prediction error", unit="m")._repr_html_())
    assert found.caption == "Prediction error (m)"
    assert found.tags <= {"table", "caption", "thead", "tbody", "tr", "th", "td", "b", "div"}
    assert found.attributes <= {"colspan", "align"}, "styles are lost in notebooks that are not trusted"
    words = [[text for text, _ in row] for row in found.rows]
    assert words[0] == ["", "", "80 ms", "400 ms"] and words[1] == ["Walking"]
    assert words[2:4] == [["LSTM-3LR", "ours", "0.50", "2.00"], ["", "paper", "2.46", "2.41"]]
    bold = {(i, text) for i, row in enumerate(found.rows) for text, is_bold in row if is_bold}
    assert bold == {(2, "0.50"), (4, "1.50"), (5, "0.135"), (5, "0.71")}


def test_markdown_for_the_readme():
    assert error_table(COLUMNS, OURS, PAPER).markdown().splitlines() == [
        "|  |  | 80 ms | 400 ms |",
        "| --- | --- | ---: | ---: |",
        "| **Walking** |  |  |  |",
        "| LSTM-3LR | ours | **0.50** | 2.00 |",
        "|  | paper | 2.46 | 2.41 |",
        "| acLSTM | ours | 0.62 | **1.50** |",
        "| ERD | paper | **0.135** | **0.71** |",
        "| **Dance** |  |  |  |",
        "| acLSTM | ours | 0.70 | – |",
    ]


def test_without_a_paper_there_is_no_column_for_whose_numbers_they_are():
    table = error_table(COLUMNS, {"Walking": OURS["Walking"]})
    assert table.markdown().splitlines()[3] == "| LSTM-3LR | **0.50** | 2.00 |"
    assert "ours" not in str(table) + table._repr_html_()


def test_the_best_is_chosen_by_what_is_written_and_ties_share_it():
    rows = {"a": [0.501, 1], "b": [0.499, 2], "c": [math.inf, 3], "d": [None, -1]}
    stars = {
        best: [
            [cell for cell in line.split()[1:]]
            for line in str(error_table(COLUMNS, {"": rows}, best=best)).splitlines()
        ]
        for best in ("lowest", "highest", None)
    }
    assert stars["lowest"][1:5] == [["*0.50", "1.00"], ["*0.50", "2.00"], ["inf", "3.00"], ["–", "*-1.00"]]
    assert stars["highest"][1:5] == [["*0.50", "1.00"], ["*0.50", "2.00"], ["inf", "*3.00"], ["–", "-1.00"]]
    assert "*" not in str(error_table(COLUMNS, {"": rows}, best=None))


def test_a_group_without_a_name_has_no_line():
    table = error_table(["a"], {"": {"row": [1.0]}}, best=None)
    assert str(table).split() == ["a", "row", "1.00"]
    assert table.markdown().count("\n") == 3 and "****" not in table.markdown()
    assert "<th colspan" not in table._repr_html_()


def test_names_cannot_break_the_table():
    table = error_table(["<b>"], {"a|b": {"<script>": [1]}})
    assert "<script>" not in table._repr_html_() and "&lt;script&gt;" in table._repr_html_()
    assert "a\\|b" in table.markdown()


def test_what_does_not_fit_is_told_in_one_line():
    with pytest.raises(TutorialError, match=r"1 numbers for 'x' of 'Walking' \(ours\), expected 2, one a column"):
        error_table(COLUMNS, {"Walking": {"x": [1.0]}})
    with pytest.raises(TutorialError, match=r"3 numbers for 'y' of 'Dance' \(paper\), expected 2"):
        error_table(COLUMNS, OURS, {"Dance": {"y": [1, 2, 3]}})
    with pytest.raises(TutorialError, match="'lowest', 'highest' or None"):
        error_table(COLUMNS, OURS, best="smallest")


def test_some_rows_and_columns_as_they_stand_in_the_whole():
    part = error_table(COLUMNS, OURS, PAPER).only(["acLSTM"], ["400 ms"])
    assert part.columns == ["400 ms"]
    assert part.groups == {
        "Walking": [("acLSTM", "ours", [("1.50", True)])],
        "Dance": [("acLSTM", "ours", [("–", False)])],
    }
    assert error_table(COLUMNS, OURS, PAPER).only().groups == error_table(COLUMNS, OURS, PAPER).groups
    for names in ({"rows": ["GRU"]}, {"columns": ["1 s"]}):
        with pytest.raises(TutorialError, match="has no"):
            error_table(COLUMNS, OURS, PAPER).only(**names)
