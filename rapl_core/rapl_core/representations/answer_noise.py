r"""Likelihoods of comparisons that may have been answered wrong.

With margin m, the log-odds that an answer is right if it was meant, and e, the probability that it
was turned round:

plain      :math:`\log\sigma(m)`
smoothing  :math:`(1 - e) \log\sigma(m) + e \log\sigma(-m)` (label smoothing, Szegedy et al. 2016)
estimated  :math:`\log[(1 - e)\,\sigma(m) + e\,\sigma(-m)]` (random flips, Christiano et al. 2017)

The last is bounded: the gradient of an answer that contradicts all others vanishes.
"""

import torch
from torch.nn.functional import logsigmoid

from rapl_core.types import Noise


def log_likelihood(
    margin: torch.Tensor, mistakes: torch.Tensor | None, noise: Noise
) -> torch.Tensor:
    """Log-likelihood of comparisons.

    :param margin: (..., B).
    :param mistakes: (B,) e of each; None: none are wrong.
    :return: (..., B)
    """
    if noise == "plain" or mistakes is None:
        return logsigmoid(margin)
    if noise == "smoothing":
        return (1 - mistakes) * logsigmoid(margin) + mistakes * logsigmoid(-margin)
    right = torch.log1p(-mistakes) + logsigmoid(margin)
    wrong = torch.log(mistakes.clamp_min(1e-12)) + logsigmoid(-margin)
    return torch.logaddexp(right, wrong)
