"""Torch's threads, for a while."""

from __future__ import annotations

import pytest
import torch

from tutorial_lib.threads import torch_threads


def test_threads_are_put_back_also_after_an_error():
    before = torch.get_num_threads()
    with torch_threads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before
    with pytest.raises(KeyError), torch_threads(before + 1):
        raise KeyError
    assert torch.get_num_threads() == before
