"""The resolved settings of a run, kept as ``config.yaml`` in its folder."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from rapl_core.atomic import write_atomically
from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.preferences.own_videos import online_alignments, online_share, online_steps
from rapl_core.preferences.strategies import strategy_of
from rapl_core.representations.methods import get_method, method_names

CONFIG_FILE = "config.yaml"
RESULTS_FILE = "results.json"
WEB_ADDRESS_FILE = "web_address"
"""Where the page is while it runs, its token included."""
_ALIGNED = ("rankings", "demonstrations")
"""Lessons of methods whose head is trained."""
PROBE_BYTES = 64 * 1024
"""Written and removed before a run begins: an empty file can be made on a full disk too."""


@dataclass(frozen=True)
class RunConfig:
    """Everything that a run depends on; ``config.yaml`` in the run folder."""

    task: str
    reward: str = "rapl"
    encoder: str = ""
    """Encoder that embeds the pictures; empty: the one that ``reward`` implies."""
    preset: str = "tuned"
    seed: int = 0
    worlds: int = 4
    pool_episodes: int = 300
    """Videos in the pool that is ranked."""
    triplets: int = 150
    """Rankings in all, those about the robot's own videos among them."""
    demonstrations: int = 500
    """Preferred demonstrations, for the methods that learn from them (tcc, tcc_ot)."""
    backbone: str = ""
    """Network that an encoder is made on; empty: the one that its method names."""
    weights: str = ""
    """File with that network's weights, or a folder that holds it as <backbone>.pt."""
    engine: str = "torch"
    """What computes the features that alignment reads and the robot is rewarded by: torch, or
    openvino."""
    trained: str = "head"
    """What alignment trains: the last layer, or the backbone's last block with it."""
    tcc_iterations: int = 4_000
    masked_iterations: int = 1_500
    """Of mae_scratch and mvp_finetuned."""
    online: int | None = None
    """Alignments while the robot learns, from rankings of its own videos too; None: the preset's
    own."""
    online_triplets: int | None = None
    """Of the rankings, kept for each of them; None: half of all, shared out."""
    steps: int = 40_000
    """World steps of learning, all worlds together."""
    random_steps: int = 2_000
    """World steps with random actions before the first gradient step."""
    checkpoint_every: int = 5_000
    """World steps between two checkpoints: what a killed learner loses at most."""
    evaluate_every: int = 10_000
    """World steps between two evaluations while learning."""
    evaluate_episodes: int = 50
    """Episodes of each of these."""
    final_episodes: int = 50
    """Episodes of the evaluation after learning."""
    quick: bool = False
    human: str = "simulated"
    """Who ranks: simulated, or people on the page (web)."""
    strategy: str = ""
    """Which videos are asked about next; empty: the preset's own."""
    noise: str = "plain"
    """What alignment makes of wrong answers."""
    groups: int = 1
    """Representations to learn, one a group of annotators who agree; 0: as many as needed."""
    people: str = ""
    """Simulated people and their wishes, name:wish,name:wish; empty: one who wants the task."""
    knobs: str = ""
    """How simulated people err, e.g. beta=2,mistakes=0.1; empty: never."""

    @property
    def uses_rankings(self) -> bool:
        """True when the reward comes from videos that were ranked."""
        return self.reward != "ground_truth"

    @property
    def query_strategy(self) -> str:
        """Which videos are asked about next."""
        return self.strategy or strategy_of(self.preset)

    @property
    def asks_people(self) -> bool:
        """True when people give the rankings."""
        return self.human == "web"

    @property
    def online_alignments(self) -> int:
        """Alignments while the robot learns."""
        if self.online is not None:
            return self.online
        wanted = online_alignments(self.preset)
        is_apt = self._gains_by_rankings and self.groups == 1 and self.trained == "head"
        return wanted if is_apt and online_share(self.triplets, wanted) else 0

    @property
    def online_share(self) -> int:
        """Rankings kept for each alignment while the robot learns."""
        if self.online_triplets is not None:
            return self.online_triplets
        return online_share(self.triplets, self.online_alignments)

    @property
    def pool_triplets(self) -> int:
        """Rankings of videos of the pool, before the robot learns."""
        return self.triplets - self.online_alignments * self.online_share

    @property
    def online_steps(self) -> list[int]:
        """World steps at which the alignments while learning begin."""
        return online_steps(self.steps, self.online_alignments, self.random_steps)

    @property
    def _gains_by_rankings(self) -> bool:
        return self._lesson == "rankings" and self.reward_encoder == self.reward

    def check_online(self) -> None:
        """
        :raises RaplError: if it is to align while the robot learns and more rankings would not
            change the reward, or none would be left to begin with.
        """
        if not self.online_alignments:
            if self.online_triplets:
                raise RaplError(
                    "--online-triplets: this run is not aligned while the robot learns, so it "
                    "keeps no rankings for it; see --online"
                )
            return
        if self.online_share < 1 or self.pool_triplets < 1:
            raise RaplError(
                f"{self.online_alignments} alignments while the robot learns, of "
                f"{self.online_share} rankings each, leave {self.pool_triplets} of "
                f"{self.triplets} for the videos before; expected at least 1"
            )
        if self.groups != 1:
            raise RaplError(
                f"--online with --groups {self.groups}: from one alignment to the next another "
                "group could be the largest, and the robot would learn what it wants"
            )
        if self.trained != "head":
            raise RaplError(
                f"--online with --trained {self.trained}: each alignment would make another "
                "backbone, and all that the robot has seen would go through it again; expected 0"
            )
        if self._gains_by_rankings:
            return
        encoder = f" with encoder '{self.encoder}'" if self.encoder else ""
        known = [name for name in method_names() if get_method(name).lesson == "rankings"]
        raise RaplError(
            f"--online aligns again from more rankings, and reward '{self.reward}'{encoder} "
            f"learns nothing from them; rewards that do: {', '.join(known)}"
        )

    def check_trained(self) -> None:
        """
        :raises RaplError: if more than a head is to learn in an encoder that has none to learn.
        """
        if self.trained == "head" or self.aligns:
            return
        known = [n for n in method_names() if get_method(n).lesson in _ALIGNED]
        raise RaplError(
            f"--trained {self.trained} says what alignment trains, and reward '{self.reward}' has "
            f"no head to train; rewards that have: {', '.join(known)}"
        )

    @property
    def aligns(self) -> bool:
        """True when an encoder's head is trained, as the preset says."""
        return self._lesson in _ALIGNED

    @property
    def uses_demonstrations(self) -> bool:
        """True when the encoder learns from preferred demonstrations."""
        return self._lesson == "demonstrations"

    @property
    def _lesson(self) -> str:
        known = self.reward in method_names()
        return get_method(self.reward).lesson if known else ""

    @property
    def reward_encoder(self) -> str:
        """Encoder whose embeddings the reward is computed from; empty with ground_truth."""
        return "" if self.reward == "ground_truth" else (self.encoder or self.reward)


def save_config(config: RunConfig, folder: Path, resolved: dict[str, Any] | None = None) -> Path:
    """Write ``config.yaml`` atomically.

    :param resolved: further sections, for the reader only (versions, machine, node parameters).
    :raises RaplError: if it cannot be written.
    """
    text = yaml.safe_dump({"run": asdict(config), **(resolved or {})}, sort_keys=False)
    return write_atomically(folder / CONFIG_FILE, text, "the settings to")


def load_config(folder: Path) -> RunConfig:
    """Read the settings of the run in ``folder``.

    :raises CorruptFileError: if there is no run or its settings cannot be read.
    """
    path = folder / CONFIG_FILE
    try:
        values = yaml.safe_load(path.read_text())["run"]
        # A run from before there were alignments while the robot learns.
        return RunConfig(**{"online": 0, **values})
    except FileNotFoundError as error:
        raise CorruptFileError(f"{folder} holds no run: {CONFIG_FILE} is missing") from error
    except (OSError, yaml.YAMLError, TypeError, KeyError) as error:
        raise CorruptFileError(f"cannot read {path}: {error}") from error


def check_writable(folder: Path) -> None:
    """Create ``folder`` and prove that files with something in them can be written there.

    :raises RaplError: if not, with the reason.
    """
    probe = folder / f".write-test-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with probe.open("wb") as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise RaplError(
            f"cannot write to the run folder {folder}: {error.strerror}; give another with --out"
        ) from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)


def where(addresses: Sequence[str]) -> str:
    """Say in words what WEB_ADDRESS_FILE holds: where people rank, and where one watches if that
    has a token of its own."""
    live = [address for address in addresses if "/live#" in address]
    rank = [address for address in addresses if address not in live]
    watch = f"; to watch and steer: {live[0]}" if live else ""
    return " or ".join(rank) + watch
