"""The command `paper`."""

import json
from pathlib import Path

from quadpend_train.common.files import write_text


def paper(gains: str = "paper", out: Path = Path("results/paper")) -> None:
    """Repeat the experiment of the paper and draw its Figures 4 to 10.

    Args:
        gains: Gains of the controller: "paper" or "matched".
        out: Folder for the figures (PNG, SVG) and merit.json.
    """
    out.mkdir(parents=True, exist_ok=True)
    from quadpend_baselines.paper import experiment, figures

    results = experiment.run(gains)
    figures.draw(results, out)
    merit = {name: experiment.figures_of_merit(trajectory) for name, trajectory in results.items()}
    write_text(out / "merit.json", json.dumps(merit, indent=1, allow_nan=False) + "\n")
    print(f"Written: {out}/figure_4 to figure_10 (.png, .svg) and merit.json")
