"""The file with the token of the live page's owner."""

import pytest

from spheremouse.errors import ControlError
from spheremouse.files.token import own_token, read_token


def test_a_token_is_made_once_and_only_owner_and_group_read_it(tmp_path):
    path = tmp_path / "new" / "view.token"
    token = own_token(path)
    assert own_token(path) == read_token(path) == token
    assert len(token) > 32
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_file_without_a_token_is_refused_with_the_remedy(tmp_path):
    path = tmp_path / "view.token"
    with pytest.raises(ControlError, match="start `spheremouse view` first"):
        read_token(path)
    for text in ("", "short\n", "x" * 5000):
        path.write_text(text)
        with pytest.raises(ControlError, match=f"{path}: "):
            read_token(path)
    (tmp_path / "file").touch()
    with pytest.raises(ControlError, match="--token-file"):
        own_token(tmp_path / "file" / "view.token")
