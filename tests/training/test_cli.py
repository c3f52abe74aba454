import pickle

import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.training import one_line_errors


@one_line_errors()
def decorated(value: int) -> int:
    """Of this module, so that it can be pickled by its name."""
    if value < 0:
        raise ConfigError("too\nsmall")
    return 2 * value


def test_what_it_decorates_keeps_its_value_and_can_be_called_again(capsys):
    assert (decorated(2), decorated(3)) == (4, 6)
    for _ in range(2):
        with pytest.raises(SystemExit) as caught:
            decorated(-1)
        assert caught.value.code == 1 and capsys.readouterr().err == "error: too small\n"


def test_it_can_be_sent_to_another_process():
    guard = pickle.loads(pickle.dumps(one_line_errors()))
    with pytest.raises(SystemExit), guard:
        raise ConfigError("no")
