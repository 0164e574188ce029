"""The short version of the study of networks."""

from __future__ import annotations

import pytest

from analysis.network_examples.study import STUDY


@pytest.mark.slow
def test_every_number_of_the_examples_meets_its_target(tmp_path, capsys):
    assert STUDY.main(["--quick", "--runs", "10", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "MISS" not in said
    assert {p.name for p in tmp_path.iterdir()} >= {
        "network.html",
        "figure_4_2.html",
        "figure_6_1.html",
        "figure_6_2.html",
        "predictors.csv",
        "fits.csv",
        "targets.json",
    }
