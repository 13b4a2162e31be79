"""The check of the documentation's words finds them in prose, and nowhere else."""

import pytest
import words


@pytest.mark.parametrize(
    ("name", "text", "lines"),
    [
        ("page.md", "A run goes\non with `anew`.\n```python\nanew = 1\n```\n[a](anew.md) begins anew.\n", [1, 6]),
        ("module.py", '"""Begin anew."""\nanew = 1\nraise ValueError(f"the bath {anew} is none")\n', [1, 3, 3]),
        ("comments.py", "# Begin\n# anew, with `anew`.\nx = 1  #: of a bath\ny = '#'\n# go\n# on\n", [2, 3, 5]),
    ],
)
def test_words_are_found_in_prose_docstrings_messages_and_comments(name, text, lines, tmp_path, monkeypatch):
    monkeypatch.setattr(words, "ROOT", tmp_path)
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    assert sorted(int(fault.split(":")[1]) for fault in words.faults(file)) == lines


def test_files_that_are_not_edited_yet_exist():
    for pattern in words.WORDS["unchecked"]:
        assert list(words.ROOT.glob(pattern)), pattern
    assert words.ROOT / "docs" / "index.md" in words.files()
