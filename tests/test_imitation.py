"""The imitation of the documentation, shortened."""

import re
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")
PAGE = Path(__file__).parent.parent / "docs" / "guides" / "imitate.md"


@pytest.mark.filterwarnings("ignore")  # of torch and Stable-Baselines3
def test_the_documented_imitation_comes_close_to_its_teacher(
    tmp_path, monkeypatch, capsys
):
    code = re.search(
        r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )[1]
    shorter = code.replace("32, 500, 8, 1000", "8, 100, 2, 200").replace(
        '"mpc-friction"', '"lqg"'
    )
    assert shorter.count("8, 100, 2, 200") == shorter.count('"lqg"') == 1
    monkeypatch.chdir(tmp_path)
    exec(compile(shorter, str(PAGE), "exec"), {})
    errors = [
        float(word) for word in re.findall(r"([\d.]+) A", capsys.readouterr().out)
    ]
    assert len(errors) == 2 and errors[-1] < 0.5  # A; the currents have an RMS of 2.4 A
    assert (tmp_path / "imitation.zip").exists()
