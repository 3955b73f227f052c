"""Write the tables of training settings and of presets: ``python -m docs.tools.settings``."""

import json
from pathlib import Path

from experiments.pages import POLICIES, fill
from quadpend_train.common.declarations import meanings
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.training.settings import ApgSettings, HybridSettings, TrainSettings, presets, read_settings

PAGE = Path(__file__).parents[1] / "reference/settings.md"
GROUPS = {
    "settings": TrainSettings,
    "hybrid": HybridSettings,
    "apg": ApgSettings,
}


def settings_list(kind: type) -> str:
    """Return the list of a settings class: name, default value as JSON, and meaning."""
    texts, lines = meanings(kind), []
    for name, value in vars(kind()).items():
        if name != "arguments":  # in files the table of the algorithm
            value = [scenario.name for scenario in value] if name == "scenarios" else value
            default = "" if hasattr(value, "__dataclass_fields__") else f" (`{json.dumps(value)}`)"
            lines.append(f"- `{name}`{default}: {texts[name]}")
    return "\n".join(lines)


def presets_table() -> str:
    """Return the table of the presets, with the durations that the cards of their trained policies state."""
    lines = ["| preset | timesteps | duration | description |", "|---|---|---|---|"]
    for name, description in presets().items():
        lines.append(f"| `{name}` | {read_settings(name).total_timesteps:,} | {_duration(name)} | {description} |")
    return "\n".join(lines)


def _duration(preset: str) -> str:
    """Return the range of the training times of the policies of a preset, if there are any."""
    files = [path for folder in (SHIPPED, POLICIES) for path in folder.glob(f"{preset}-[0-9].npz")]
    if not files:
        return "–"
    seconds = sorted(float(MlpPolicy.load(path).card["seconds"]) for path in files)
    return "–".join(dict.fromkeys(f"{value:.0f}" for value in (seconds[0], seconds[-1]))) + " s"


def tables() -> dict[str, str]:
    """Return the generated parts of the page by name."""
    return {**{name: settings_list(kind) for name, kind in GROUPS.items()}, "presets": presets_table()}


if __name__ == "__main__":
    fill(PAGE, tables())
