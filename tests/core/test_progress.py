"""Lines of progress: in place on a terminal, now and then in a log."""

import pytest

from physkin_core import progress


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass only when a test says so."""
    seconds = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: seconds[0])
    return seconds


def test_a_log_gets_a_line_every_half_minute(clock, capsys):
    """With the time left; nothing of what is soon done, and nothing at the end."""
    watch = progress.progress_line("drawing")
    for seconds, share in ((0.5, 0.01), (29, 0.2), (40, 0.25), (45, 0.3), (75, 0.5), (150, 1.0)):
        clock[0] = 100.0 + seconds
        watch(share)
    assert capsys.readouterr().err == "drawing: 25%, 2:00 left\ndrawing: 50%, 1:15 left\n"


def test_a_terminal_has_one_line_that_goes(clock, capsys, monkeypatch):
    """Not before a second has passed."""
    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: True, raising=False)
    watch = progress.progress_line("drawing")
    for seconds, share in ((0.5, 0.1), (2, 0.5), (4, 1.0)):
        clock[0] = 100.0 + seconds
        watch(share)
    assert capsys.readouterr().err == "\r\x1b[Kdrawing: 50%, 0:02 left\r\x1b[K"
