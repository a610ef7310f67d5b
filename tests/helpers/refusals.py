"""What the command line says of what it can't do."""


def one_line(result, *words):
    """A command was refused in one line, which has these words."""
    assert result.code == 2, result
    assert len(result.complaints) == 1, result.err
    for word in words:
        assert word in result.err
