"""Write the JSON schemas of scenario, vehicle and training files into `docs/schemas`: ``python -m docs.tools.schemas``.

An editor checks and completes a TOML file whose first line is ``#:schema scenario.schema.json``.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles import Vehicle
from quadpend_train.training.settings import TrainSettings

FOLDER = Path(__file__).parents[1] / "schemas"
KINDS: dict[str, Any] = {"scenario": Scenario, "vehicle": Vehicle, "training": TrainSettings}


def schema(name: str) -> str:
    """Return the schema of a kind of file as JSON.

    The arguments of an algorithm are in a table of any name, in the file of a training.
    """
    found = TypeAdapter(KINDS[name]).json_schema()
    if found["properties"].pop("arguments", None):
        found["additionalProperties"] = {"type": "object"}
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for kind in KINDS:
        (FOLDER / f"{kind}.schema.json").write_text(schema(kind), encoding="utf-8")
