"""A store of rankings."""

from pathlib import Path

import pytest

from rapl_core.preferences import RankingStore


@pytest.fixture
def store(tmp_path: Path) -> RankingStore:
    """An empty one."""
    return RankingStore(tmp_path / "rankings.sqlite")
