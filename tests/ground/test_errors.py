"""Messages: one line, of a length that a terminal shows, whatever was in the file."""

from palpate.errors import RecordError


def test_what_a_terminal_obeys_is_written_out():
    said = str(RecordError("column 'a\nb\x1b[31m\r\u202e' is unknown: µm, m², a blank"))
    assert said == r"column 'a\nb\x1b[31m\r\u202e' is unknown: µm, m², a blank"


def test_the_middle_of_a_long_message_is_left_out():
    said = str(RecordError("begin " + "x" * 100_000 + " end"))
    assert said.startswith("begin xxx")
    assert said.endswith("xxx end")
    assert len(said) < 1300
