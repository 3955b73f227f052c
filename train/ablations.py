"""docs/learning.md: what the parts of `train/lab.py` add: three seeds, about ten minutes on one core for each row.

    python train/ablations.py              # trains in runs/ablations/ what is missing, and prints the table
    python train/ablations.py whole gru    # some rows

In "gru" 88 gated recurrent units read the latest sample, and take the place of all filters, whose feedback is not added
either. The networks learn the units too, by gradients through the 16 steps of a window of imitation, and through the
100 of a window of gradients.
"""

import argparse
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from lab import CHANGES, Networks, Trainer, imitation_loss, parse
from quadpend_baselines.hybrid import LabOnly
from quadpend_baselines.hybrid.lab import FILTER, LAB_SIZE, LAGS
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_gym.core.settings import settings
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.policies.mlp_policy import MlpPolicy

RUNS = Path("runs/ablations")
SIZES = "--device", "c", "--seeds", "0", "1", "2", "--rows", "10", "--kernels", str(RUNS / "kernels")
BOTH = "--imitation", "280", "--gradients", "120"
GENTLE = [name for name, (base, _) in CHANGES.items() if not base.startswith("event")]
ROWS: dict[str, tuple[str, ...]] = {
    "whole": BOTH,
    "no events": (*BOTH, "--scenarios", *GENTLE),
    "no memory": (*BOTH, "--without", "lags", "filter"),
    "gru": BOTH,
    "imitation": ("--imitation", "1500", "--gradients", "0"),
    "gradients": ("--imitation", "0", "--gradients", "150"),
}
MEMORY = np.r_[LAGS, FILTER]  # inputs whose places the units take
SAMPLE = np.setdiff1d(np.arange(LAB_SIZE), MEMORY)  # inputs that they read
UNITS = len(MEMORY)
FOLLOWING = slice(LAGS.stop, LAGS.stop + ACTION_SIZE)  # the command of the trajectory


class Units(nn.Module):
    """Gated recurrent units of several networks, side by side as in `Networks`."""

    def __init__(self, seeds: list[int]) -> None:
        super().__init__()
        sizes = len(SAMPLE), UNITS
        self.weights = nn.ParameterList(torch.empty(len(seeds), size, 3 * UNITS) for size in sizes)
        self.biases = nn.ParameterList(torch.zeros(len(seeds), 1, 3 * UNITS) for _ in sizes)
        for i, seed in enumerate(seeds):
            random = torch.Generator().manual_seed(seed)
            for weights in self.weights:
                for gate in weights.data[i].chunk(3, 1):
                    nn.init.orthogonal_(gate, generator=random)
            self.biases[0].data[i, 0, UNITS : 2 * UNITS] = torch.linspace(-1.0, 5.0, UNITS)  # they keep 0.03 to 1.5 s

    def forward(self, inputs: Tensor, last: Tensor) -> Tensor:
        """Return the units after inputs of shape (networks, n, `LAB_SIZE`), shape (networks, n, `UNITS`)."""
        read = torch.baddbmm(self.biases[0], inputs[..., SAMPLE], self.weights[0]).chunk(3, 2)
        kept = torch.baddbmm(self.biases[1], last, self.weights[1]).chunk(3, 2)
        resets, keeps = (torch.sigmoid(read[i] + kept[i]) for i in range(2))
        new = torch.tanh(read[2] + resets * kept[2])
        return new + keeps * (last - new)

    @staticmethod
    def placed(inputs: Tensor, units: Tensor) -> Tensor:
        """Return inputs of shape (networks, n, `LAB_SIZE`) with the units in the places of the filters."""
        return inputs.index_copy(2, torch.from_numpy(MEMORY), units)


class RecurrentNetworks(Networks):
    """Networks that have units, beside each other."""

    def __init__(self, seeds: list[int]) -> None:
        super().__init__(seeds, [])
        self.units = Units(seeds)


class RecurrentTrainer(Trainer):
    """The training of networks with units, whose outputs are added to the command of the trajectory alone."""

    near = FOLLOWING

    def __init__(self, args: argparse.Namespace) -> None:
        super().__init__(args)
        flight = self.flight
        flight.memory = flight.zeros(len(flight.memory) + UNITS, flight.rows)

    def make_networks(self) -> nn.Module:
        """Return the untrained networks."""
        return RecurrentNetworks(self.args.seeds)

    def inputs(self, seen: Tensor, action: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs of the networks and their memory."""
        flight, networks = self.flight, self.flight.for_networks
        found, after = flight.inputs(seen, action, memory[:-UNITS])
        units = self.networks.units(networks(found), networks(memory[-UNITS:]))
        return flight.for_rows(Units.placed(networks(found), units)), torch.cat([after, flight.for_rows(units)])

    def imitate(self) -> None:
        """Fly a window, and fit the networks to the actions of the teacher in it."""
        self.first = self.flight.for_networks(self.flight.memory[-UNITS:].clone())
        super().imitate()

    def fit(self, inputs: list[Tensor], labels: list[Tensor]) -> None:
        """Fit the networks to outputs in some steps, shapes (networks, rows of one, k)."""
        order = torch.rand(inputs[0].shape[1]).argsort()
        for part in order[: len(order) // 8 * 8].view(8, -1):
            units, losses = self.first[:, part], []
            for x, y in zip(inputs, labels, strict=True):
                units = self.networks.units(x[:, part], units)
                losses.append(imitation_loss(self.networks(Units.placed(x[:, part], units)), y[:, part]))
            self.descend(torch.stack(losses).mean(0))


@settings
class RecurrentLab(LabOnly):
    """Hybrid of one of several networks with units."""

    kind: ClassVar[str] = "recurrent_lab"
    units: Any = None
    number: int = 0  # of the network

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        (filters,) = super().parts(size)

        def read(_: None, seen: Seen, memory: Any) -> tuple[Any, Any]:
            found, after = filters.function(filters.numbers, seen, memory[:, :-UNITS])
            given = (torch.from_numpy(item.astype(np.float32)) for item in (found, memory[:, -UNITS:]))
            with torch.no_grad():
                units = self.units(*(item.expand(3, -1, -1) for item in given))[self.number].numpy()
            found[:, MEMORY] = units
            return found, np.concatenate([after, units], axis=1)

        return (InputPart(filters.size, filters.memory_size + UNITS, read, None),)

    def builds_on(self, inputs: Any, base_action: Any) -> Any:
        """Return the command of the trajectory; see `Hybrid.builds_on`."""
        return inputs[:, FOLLOWING]


def trained(name: str) -> list[MlpPolicy]:
    """Return the networks of a row, trained if they are missing."""
    out = RUNS / name.replace(" ", "-")
    kind = RecurrentTrainer if name == "gru" else Trainer
    files = [out / f"lab-{seed}.npz" for seed in range(3)]
    if not files[0].is_file():
        kind(parse([*SIZES, "--out", str(out), *ROWS[name]])).train()
    policies = [MlpPolicy.load(file) for file in files]
    if name == "gru":
        networks = RecurrentNetworks([0, 1, 2])
        networks.load_state_dict(torch.load(out / "training.pt")["networks"])
        for number, policy in enumerate(policies):
            policy.hybrid, policy.fingerprint = RecurrentLab(units=networks.units, number=number), None
    return policies


def main() -> None:
    """Train what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[*ROWS], metavar="NAME", help=f"rows: {', '.join(ROWS)}")
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = []
    for name in given.names:
        sets, policies = ("flight", "events"), {name: trained(name)}
        gentle, events = (compare(policies, [part], 24, VALIDATION_SEED).ranking[0] for part in sets)
        table.append([name, *map(format_interval, (gentle.multiple, gentle.survival, events.survival))])
    print(markdown_table(["training", "multiple", "survival, gentle (%)", "survival, events (%)"], table))


if __name__ == "__main__":
    main()
