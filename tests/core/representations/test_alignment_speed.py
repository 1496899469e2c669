"""An alignment is a matter of seconds once the features are there."""

import time

import numpy as np
import torch

from rapl_core.representations.alignment import Lesson
from rapl_core.representations.presets import TUNED
from rapl_core.representations.rapl import fit_rapl
from rapl_core.types import Triplet


def test_150_triplets_of_50_frames_take_seconds_of_one_processor():
    rng = np.random.default_rng(0)
    features = {f"v{i}": rng.normal(size=(50, 1792)).astype(np.float32) for i in range(250)}
    names = sorted(features)
    triplets = [Triplet(*rng.choice(names, 3, replace=False)) for _ in range(150)]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        start = time.process_time()  # other processes do not count
        fit_rapl(features, Lesson(triplets, names[:10]), TUNED, rng)
        taken_s = time.process_time() - start
    finally:
        torch.set_num_threads(threads)
    assert taken_s < 10.0  # 4 to 5 s on the machine of the README's figures
