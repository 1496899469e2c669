"""Episodes on disk: one rosbag2 folder with an MCAP file each, and a short summary beside it."""

from rapl_core.episodes.joints import JointTrack
from rapl_core.episodes.reading import read_episode, read_frames, read_joints
from rapl_core.episodes.store import EpisodeStore
from rapl_core.episodes.summary import EpisodeSummary, read_summary
from rapl_core.episodes.writing import write_episode

__all__ = [
    "EpisodeStore",
    "EpisodeSummary",
    "JointTrack",
    "read_episode",
    "read_frames",
    "read_joints",
    "read_summary",
    "write_episode",
]
