"""The lint of words refuses what the glossary retires, and nothing else."""

from pathlib import Path

import pytest
from tool_scripts import load

check_words = load("check_words")
GLOSSARY = check_words.read_glossary(
    "# Retired words\n"
    "| in place of | write | where |\n|---|---|---|\n"
    "| hear, heard | receive | messages |\n"
    "| way | route | names |\n"
    "| foretold | predicted | all |\n"
    "| null plant | mock plant | all |\n"
    "# Exceptions\n"
    "| name | in | why |\n|---|---|---|\n"
    "| `way_point` | `.` | of the field |\n"
    "| `hear` | `audio`, `radio/receiver.py` | of the field |\n"
)


def found(source: str, name: str = "module.py") -> list[str]:
    sentences = check_words.violations(GLOSSARY, Path(name), source)
    return [sentence.split(": ", 1)[1] for sentence in sentences]


@pytest.mark.parametrize(
    "source",
    [
        "def hear_imu(): ...",
        "class LastHeard: ...",
        "def f(is_heard): ...",
        "heard = 1",
        "self.heardAt = 1",
        "x = {'heard_by': 1}",
        "for way in (): ...",
        "x = 'drive_way'",
        "NULL_PLANT = 1",
        "import numpy as way",
    ],
)
def test_a_retired_word_within_a_name_is_refused(source: str):
    assert len(found(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        "x = stream.hear()",  # defined elsewhere
        "def f():\n    'It is on its way, as we hear.'",
        "# by the way",
        "x = 'half the way is done'",
        "overheard = 1",
        "way_point = 1",
    ],
)
def test_ordinary_sentences_and_names_of_others_pass(source: str):
    assert found(source) == []


@pytest.mark.parametrize(
    ("file", "excepted"),
    [
        ("audio/deep/microphone.py", True),
        ("radio/receiver.py", True),
        ("radio/sender.py", False),
        ("audio_more/ears.py", False),
    ],
)
def test_an_exception_holds_in_its_files_and_folders_only(file: str, excepted: bool):
    assert (found("def hear(): ...", file) == []) is excepted
    assert found("def hear_imu(): ...", file) != []


def test_messages_and_texts_have_lists_of_their_own():
    assert found("x = f'{name} was not heard'") == ["'heard' in 'was not heard': write receive"]
    assert found("# as was foretold") == ["'foretold' in '# as was foretold': write predicted"]
    assert found("The null plant.", "page.md") == [
        "'null plant' in 'The null plant.': write mock plant"
    ]


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("plan.yaml", "legs:\n  - way: straight\n"),
        ("page.js", "const heardLast = 1;"),
        ("page.js", "  hear(sample) {"),
        ("heard.py", ""),
    ],
)
def test_keys_scripts_and_files_are_names_too(name: str, source: str):
    assert len(found(source, name)) == 1


def test_a_violation_names_line_word_and_term():
    assert check_words.violations(GLOSSARY, Path("a/b.py"), "x = 1\nway = 2\n") == [
        "a/b.py:2: 'way' in 'way': write route"
    ]


def test_a_glossary_without_its_table_is_refused():
    with pytest.raises(ValueError, match="no table of retired words"):
        check_words.read_glossary("# Glossary\n")
