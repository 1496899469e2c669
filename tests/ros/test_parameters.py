"""Config dataclasses as parameters, and back."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from rapl_core.errors import RaplError, ShapeError
from rapl_core.policies import SacConfig, ScheduleConfig
from rapl_core.streaming.reward_desk import DeskConfig
from rapl_ros.parameters import ConfigParameters, ParameterError, declare_config, field_docs

pytestmark = pytest.mark.usefixtures("rclpy_context")


@dataclass(frozen=True)
class Solver:
    epsilon: float = 0.05
    """Entropy."""
    iterations: int = field(default=100, metadata={"minimum": 1, "maximum": 1000})

    def __post_init__(self) -> None:
        if self.epsilon <= 0:
            raise ShapeError(f"epsilon is {self.epsilon}, expected more than 0")


@dataclass(frozen=True)
class Config:
    cost: Literal["cosine", "euclidean"] = "cosine"
    """How far two embeddings
    are from each other."""
    name: str = field(default="rapl", metadata={"description": "Of the encoder."})
    folder: Path = Path("runs/a")
    weights: Path | None = None
    limit: float | None = None
    layers: tuple[int, ...] = (256, 256)
    tags: tuple[str, ...] = ()
    enabled: bool = True
    solver: Solver = Solver()


@pytest.fixture
def make_node():
    nodes = []

    def make(*overrides: Parameter) -> Node:
        nodes.append(Node(f"holder_{len(nodes)}", parameter_overrides=list(overrides)))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_without_overrides_the_config_is_its_default(make_node):
    assert declare_config(make_node(), Config()) == Config()


def test_overrides_arrive_in_every_type_and_in_groups(make_node):
    node = make_node(
        Parameter("c.cost", value="euclidean"),
        Parameter("c.folder", value="runs/b"),
        Parameter("c.weights", value="w.safetensors"),
        Parameter("c.limit", value=0.5),
        Parameter("c.layers", value=[64]),
        Parameter("c.tags", value=["x", "y"]),
        Parameter("c.enabled", value=False),
        Parameter("c.solver.epsilon", value=0.2),
        Parameter("c.solver.iterations", value=7),
    )
    assert declare_config(node, Config(), "c") == Config(
        cost="euclidean",
        folder=Path("runs/b"),
        weights=Path("w.safetensors"),
        limit=0.5,
        layers=(64,),
        tags=("x", "y"),
        enabled=False,
        solver=Solver(0.2, 7),
    )


def test_descriptions_come_from_metadata_or_the_docstring_under_the_field(make_node):
    node = make_node()
    declare_config(node, Config())
    assert node.describe_parameter("cost").description == (
        "How far two embeddings are from each other."
    )
    assert node.describe_parameter("cost").additional_constraints == "one of: cosine, euclidean"
    assert node.describe_parameter("name").description == "Of the encoder."
    assert node.describe_parameter("solver.epsilon").description == "Entropy."
    allowed = node.describe_parameter("solver.iterations").integer_range[0]
    assert (allowed.from_value, allowed.to_value) == (1, 1000)
    assert field_docs(Solver) == {"epsilon": "Entropy."}


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("solver.iterations", 0, "solver.iterations"),
        ("solver.iterations", 1001, "solver.iterations"),
        ("solver.epsilon", float("nan"), "parameter 'solver.epsilon' is nan, expected a number"),
        ("solver.iterations", "many", "another type than integer"),
        ("cost", "manhattan", "parameter 'cost' is 'manhattan'; known: cosine, euclidean"),
    ],
)
def test_a_bad_override_is_refused_by_name(make_node, name, value, complaint):
    with pytest.raises(ParameterError, match=complaint):
        declare_config(make_node(Parameter(name, value=value)), Config())


def test_what_is_left_out_is_no_parameter_and_keeps_its_default(make_node):
    node = make_node(Parameter("c.name", value="other"), Parameter("c.enabled", value=False))
    config = declare_config(node, Config(), "c", left_out=["name", "solver.epsilon"])
    assert config == Config(enabled=False)
    assert not node.has_parameter("c.name") and not node.has_parameter("c.solver.epsilon")
    assert node.has_parameter("c.solver.iterations")


@pytest.mark.parametrize(
    ("defaults", "name", "value"),
    [
        (DeskConfig(), "embedding_deadline_s", -1.0),
        (DeskConfig(), "state_deadline_s", 0.0),
        (DeskConfig(), "human_reward_scale", float("nan")),
        (DeskConfig(), "human_reward_scale", -2.0),
        (SacConfig(), "batch_size", 0),
        (SacConfig(), "learning_rate", -1e-3),
        (SacConfig(), "discount", 1.5),
        (SacConfig(), "entropy_coefficient", "automatic"),
        (SacConfig(), "entropy_coefficient", "auto_0"),
        (ScheduleConfig(), "train_ratio", -1.0),
        (ScheduleConfig(), "train_ratio", float("inf")),
        (ScheduleConfig(), "evaluate_every", -1),
    ],
)
def test_nonsense_about_rewards_and_learning_is_refused_by_name(make_node, defaults, name, value):
    with pytest.raises(RaplError, match=name):
        declare_config(make_node(Parameter(name, value=value)), defaults)


def test_numbers_of_rewards_and_learning_have_a_range(make_node):
    node = make_node()
    for defaults in (DeskConfig(), SacConfig(), ScheduleConfig()):
        declare_config(node, defaults)
        for field_ in fields(defaults):
            if type(getattr(defaults, field_.name)) in (int, float):  # a bool is an int too
                described = node.describe_parameter(field_.name)
                assert described.integer_range or described.floating_point_range, field_.name


def test_what_the_dataclass_itself_refuses_is_refused_with_its_reason(make_node):
    with pytest.raises(ShapeError, match="epsilon is -1.0, expected more than 0"):
        declare_config(make_node(Parameter("solver.epsilon", value=-1.0)), Config())


def test_parameters_are_read_only_unless_meant_to_change(make_node):
    node = make_node()
    parameters = ConfigParameters(node, Config(), writable=["cost", "solver.epsilon"])
    results = node.set_parameters([Parameter("name", value="other")])
    assert not results[0].successful and "read-only" in results[0].reason
    assert node.set_parameters([Parameter("cost", value="euclidean")])[0].successful
    assert parameters.value == Config(cost="euclidean")


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("cost", "manhattan", "known: cosine, euclidean"),
        ("solver.epsilon", -2.0, "expected more than 0"),
    ],
)
def test_a_refused_change_tells_why_and_leaves_the_old_value(make_node, name, value, reason):
    node = make_node()
    parameters = ConfigParameters(node, Config(), writable=["cost", "solver.epsilon"])
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful and reason in result.reason
    assert parameters.value == Config()
    assert node.get_parameter("solver.epsilon").value == 0.05


def test_two_configs_on_one_node_do_not_disturb_each_other(make_node):
    node = make_node()
    first = ConfigParameters(node, Solver(), "first", writable=["epsilon"])
    second = ConfigParameters(node, Solver(), "second", writable=["epsilon"])
    assert node.set_parameters([Parameter("second.epsilon", value=0.7)])[0].successful
    assert (first.value.epsilon, second.value.epsilon) == (0.05, 0.7)


def test_an_unknown_writable_field_is_an_error(make_node):
    with pytest.raises(ParameterError, match="writable epsilom not among epsilon, iterations"):
        ConfigParameters(make_node(), Solver(), writable=["epsilom"])


def test_a_type_that_ros_has_no_form_for_is_refused(make_node):
    @dataclass(frozen=True)
    class Odd:
        callback: Callable[[], None] = print

    with pytest.raises(ParameterError, match="field 'callback'"):
        declare_config(make_node(), Odd())
