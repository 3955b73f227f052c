"""Every bad setting of a wind raises an error of one sentence that names the setting and its allowed values."""

from typing import Any

import numpy as np
import pytest

from quadpend_gym import Constant, Drawn, Dryden, Gusts, OrnsteinUhlenbeck, PaperGusts, Rescaled, Sinusoid, VonKarman
from quadpend_gym.wind import KINDS, Sum, as_wind
from quadpend_gym.wrappers import WindWrapper
from tests.helpers.bad_input import INF, NAN, assert_refused
from tests.helpers.envs import make, make_vec

NOT_NUMBERS = ("strong", None, True, [1.0], {"x": 1.0})
NOT_FINITE = (NAN, INF, -INF)
NOT_PAIRS = (1.0, "wide", None, (1.0,), (1.0, 2.0, 3.0), ("a", "b"), (True, 2.0), (None, 1.0))
LOADS = ("force", "bob_force", "torque", "velocity")
WITH_LOADS = (Constant, Sinusoid, Gusts, OrnsteinUhlenbeck)

Case = tuple[Any, str, Any, str]  # model, field, value, pattern of the message
BAD: list[Case] = []
for model in WITH_LOADS:
    for load in LOADS:
        BAD += [(model, load, value, f"{load} must be a number") for value in ("strong", None, True, (), (1.0, 2.0))]
        BAD += [(model, load, (1.0, 2.0, value), f"{load} must be a number, not") for value in ("strong", None, True)]
        BAD += [(model, load, value, f"{load} must be a finite number .* not -?(nan|inf)") for value in NOT_FINITE]
        BAD += [(model, load, (0.0, 0.0, NAN), f"{load} must be a finite number .* not nan")]
for model, name, least in (
    (Sinusoid, "frequency", "1e-06"),
    (OrnsteinUhlenbeck, "time_constant", "1e-06"),
    (PaperGusts, "hold", "0.001"),
):
    BAD += [(model, name, value, f"{name} must be a number, not") for value in NOT_NUMBERS]
    BAD += [(model, name, value, f"{name} must be a finite number") for value in NOT_FINITE]
    BAD += [(model, name, value, rf"{name} must be .* \[{least}, .* not") for value in (0.0, -1.0, 1e300)]
BAD += [(PaperGusts, "force", value, "force must be a number or 3 numbers, not") for value in ("strong", None, (1.0,))]
BAD += [(PaperGusts, "yaw_torque", value, "yaw_torque must be a number, not") for value in ("a", None, (0.1, 0.1, 0.1))]
BAD += [(PaperGusts, "onset", -1.0, r"onset must be a finite number in \[0, 1e\+06\] s, not -1")]
for model, names in ((Gusts, ("pause", "length", "heading")), (Drawn, ("strength", "heading"))):
    for name in names:
        BAD += [(model, name, value, f"{name} must be ") for value in NOT_PAIRS]
        BAD += [(model, name, (1.0, value), f"{name} must be a finite number .* not") for value in NOT_FINITE]
        BAD += [(model, name, (2.0, 1.0), f"{name} must be in the order .lowest, highest., not .2.0, 1.0")]
BAD += [
    (Gusts, "pause", (-0.1, 1.0), r"pause must be a finite number in \[0, 1e\+06\] s, not -0.1"),
    (Gusts, "length", (0.0, 1.0), r"length must be a finite number in \[0.01, 1e\+06\] s, not 0.0"),
    (Gusts, "length", (-1.0, 1.0), r"length must be a finite number in \[0.01, 1e\+06\] s, not -1.0"),
    (Gusts, "torque", 0.1, "torque must be 0"),
    (Drawn, "wind", 3.0, "wind must be a wind model, the name of a wind or a mapping with its kind, not 3.0"),
    (
        Drawn,
        "wind",
        Constant,
        "wind must be a wind model, the name of a wind or a mapping with its kind, not .*Constant",
    ),
    (Drawn, "wind", "gale", "no wind 'gale'; there are calm"),
    (Drawn, "wind", {"kind": "gale"}, "no kind 'gale'; the kinds are constant"),
    (Drawn, "wind", {"kind": "constant", "gust": 1.0}, "wind has no field 'gust'; its fields are force"),
    (Drawn, "wind", {"kind": "constant", "force": NAN}, "force must be a finite number"),
    (Rescaled, "wind", 3.0, "wind must be a wind model, the name of a wind or a mapping with its kind, not 3.0"),
    (Rescaled, "scale", -1.0, r"scale must be a finite number in \[0, 10000\], not -1"),
    (Rescaled, "torque_scale", (1.0, 1.0), r"torque_scale must be a number or 3 numbers, not \(1.0, 1.0\)"),
    (Rescaled, "torque_scale", -1.0, r"torque_scale must be a finite number in \[0, 10000\], not -1"),
    (
        Sum,
        "models",
        (Constant(), 3.0),
        "wind must be a wind model, the name of a wind or a mapping with its kind, not 3.0",
    ),
    (Sum, "models", (Constant(), "gale"), "no wind 'gale'; there are calm"),
]
for model in (Dryden, VonKarman):
    BAD += [
        (model, "intensity", "mild", "intensity must be light, moderate, severe or a number, not 'mild'"),
        *((model, "intensity", value, "intensity must be a number, not") for value in (None, True, ["light"])),
        *((model, "intensity", value, "intensity must be a finite number") for value in NOT_FINITE),
        *(
            (model, "intensity", value, r"intensity must be .* \[0.001, 1000\] m/s, not")
            for value in (0.0, -1.0, 1e300)
        ),
        *((model, "altitude", value, "altitude must be a number, not") for value in NOT_NUMBERS),
        *(
            (model, "altitude", value, r"altitude must be .* \[3.048, 304.8\] m, not")
            for value in (0.0, 3.0, 305.0, NAN)
        ),
        *((model, "mean_wind", value, "mean_wind must be a number, not") for value in ("strong", True, [1.0])),
        *((model, "mean_wind", value, "mean_wind must be a finite number") for value in NOT_FINITE),
        *(
            (model, "mean_wind", value, r"mean_wind must be .* \[0.001, 1000\] m/s, not")
            for value in (0.0, -1.0, 1e300)
        ),
        *((model, "heading", value, "heading must be a number, not") for value in NOT_NUMBERS),
        *((model, "heading", value, "heading must be a finite number") for value in NOT_FINITE),
        (model, "standard", "MIL-STD-1797A", "standard must be one of MIL-F-8785C, MIL-HDBK-1797, not 'MIL-STD-1797A'"),
        (model, "standard", None, "standard must be one of .* not None"),
    ]
NEEDED: dict[Any, dict[str, Any]] = {
    Drawn: {"wind": Constant()},
    Rescaled: {"wind": Constant()},
}  # required settings of a model


@pytest.mark.parametrize(
    ("model", "name", "value", "message"), BAD, ids=[f"{case[0].__name__}({case[1]}={case[2]!r})" for case in BAD]
)
def test_a_bad_setting_is_refused(model: Any, name: str, value: Any, message: str) -> None:
    assert_refused(lambda: model(**{**NEEDED.get(model, {}), name: value}), message, (TypeError, ValueError))


def test_every_field_has_a_bad_case() -> None:
    tested = {(case[0], case[1]) for case in BAD}
    for model in KINDS.values():
        fields = [field.name for field in model.__dataclass_fields__.values() if field.init]
        assert {(model, name) for name in fields} <= tested


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "still_air"])  # still air has no settings
def test_a_bad_setting_in_a_mapping_is_refused_when_an_environment_is_made(kind: str) -> None:
    """Test the first bad setting of every kind in the table above, and an unknown setting."""
    model, name, value, message = next(case for case in BAD if case[0] is KINDS[kind])
    mapping = {"kind": kind, **dict.fromkeys(NEEDED.get(model, {}), "calm"), name: value}
    unknown = {**mapping, name: None, "gust_factor": 2.0}
    for attach in (
        lambda wind: make(wind=wind),
        lambda wind: make_vec(2, wind=wind),
        lambda w: WindWrapper(make(), w),
    ):
        assert_refused(lambda attach=attach: attach(mapping), message, (TypeError, ValueError))
        assert_refused(
            lambda attach=attach: attach(unknown), "wind has no field 'gust_factor'; its fields are", ValueError
        )


def test_a_drawn_wind_needs_a_wind() -> None:
    assert_refused(lambda: as_wind({"kind": "drawn"}), "wind lacks the field 'wind'", TypeError)


class WithoutMovesAir:
    """A custom model without the attribute `moves_air`."""

    memory_size = 0

    def initial_memory(self, streams: Any) -> Any:
        return np.empty((streams.keys.size, 0))

    def sample(self, *_: Any) -> None:
        pass


def test_a_custom_model_without_a_required_attribute_is_refused() -> None:
    assert_refused(
        lambda: make(wind=WithoutMovesAir()),
        "wind must be a wind model, the name of a wind .* not .*WithoutMovesAir",
        TypeError,
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Sum(3), "(wind|models) must be .* not 3"),
        (lambda: as_wind({"kind": "sum", "models": 3}), "(wind|models) must be .* not 3"),
        (lambda: as_wind({"kind": ["sum"]}), "no kind"),
        (lambda: as_wind({"kind": "constant", "gust": 1.0, 3: 1.0}), "no field"),
        (lambda: Dryden(standard=["MIL-F-8785C"]), "standard must be"),
    ],
)
def test_values_of_wrong_types_are_refused(call: Any, message: str) -> None:
    assert_refused(call, message, (TypeError, ValueError))


def test_a_sum_of_a_name_is_the_named_wind() -> None:
    assert Sum("windy").models == as_wind("windy")
