"""The words that `make check` refuses."""


def test_words_are_found_in_prose_and_docstrings_and_not_in_code(script, tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/a.md").write_text("One.\n```\nnobody\n```\nIt starts anew.\n")
    (tmp_path / "docs/a.py").write_text(
        '"""Fine."""\ntold = 1\n\n\ndef f():\n    """x\n\n    Told.\n    """\n'
    )
    assert script("words").found(tmp_path) == ["docs/a.md:5: anew", "docs/a.py:8: Told"]


def test_the_project_has_none_of_them(script):
    assert script("words").found() == []
