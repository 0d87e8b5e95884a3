"""Numbers on command lines are refused in one line."""

import pytest

from rover_cli.command_line import main

BAD = ["-1", "x", "1.5", "1e9", "9" * 5000, "2147483648", ""]


@pytest.mark.parametrize("value", BAD, ids=range(len(BAD)))
@pytest.mark.parametrize(
    "arguments",
    [
        ("demo", "--seed"),
        ("verify", "--seed"),
        ("verify", "--runs"),
        ("bench", "--repetitions"),
        ("sweep", "plan.yaml", "--workers"),
        ("bag", "identify", "bag", "--seed"),
        ("bag", "identify", "bag", "--jobs"),
    ],
    ids=" ".join,
)
def test_a_bad_number_is_refused(
    arguments: tuple[str, ...], value: str, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as ended:
        main([*arguments[:-1], f"{arguments[-1]}={value}"])
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert arguments[-1] in last
    assert "should be a whole number from" in last
    assert len(last) < 200


@pytest.mark.parametrize("value", ["-1", "0", "x", "nan", "inf", "1e9", ""])
def test_a_bad_duration_is_refused(value: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["verify", f"--hours={value}"])
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "--hours" in last
    assert "should be a number from 0.01 to 1000" in last
