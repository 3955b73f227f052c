"""The ablations of docs/learning.md: what the parts of `train/lab.py` add, with three seeds for each row.

    python train/ablations.py              # trains in runs/ablations/ what is missing, and prints the table
    python train/ablations.py whole gru    # some rows

In "gru" and "gru imitation" 88 gated recurrent units read what "no memory" reads, and stand in the places of the
filters. They learn by gradients through the 16 steps of a window of imitation, and through the 100 of one of gradients.
"""

import argparse
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from lab import BATCHES, CHANGES, MEMORIES, Networks, Trainer, imitation_loss, parse
from quadpend_baselines.hybrid import LabOnly
from quadpend_baselines.hybrid.lab import FOLLOWING, LAB_SIZE
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_gym.core.settings import settings
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.policies.mlp_policy import MlpPolicy

RUNS = Path("runs/ablations")
SEEDS = 0, 1, 2
SIZES = "--rows", "10", "--imitation", "280", "--gradients", "120"
GENTLE = [name for name, (base, _) in CHANGES.items() if not base.startswith("event")]
ROWS: dict[str, tuple[str, ...]] = {
    "whole": SIZES,
    "no events": (*SIZES, "--rows", "21", "--scenarios", *GENTLE),
    "no memory": (*SIZES, "--without", *MEMORIES),
    "gru": SIZES,
    "imitation": (*SIZES, "--imitation", "1500", "--gradients", "0"),
    "gru imitation": (*SIZES, "--imitation", "1500", "--gradients", "0"),
    "gradients": (*SIZES, "--imitation", "0", "--gradients", "150"),
}
PLACES = np.concatenate([np.arange(LAB_SIZE)[part] for part in MEMORIES.values()])  # of the units in the inputs
READ = np.setdiff1d(np.arange(LAB_SIZE), PLACES)  # inputs that the units read
UNITS = len(PLACES)


class Units(nn.Module):
    """Gated recurrent units of several networks, side by side as in `Networks`."""

    def __init__(self, seeds: list[int]) -> None:
        super().__init__()
        sizes = len(READ), UNITS
        self.weights = nn.ParameterList(torch.empty(len(seeds), size, 3 * UNITS) for size in sizes)
        self.biases = nn.ParameterList(torch.zeros(len(seeds), 1, 3 * UNITS) for _ in sizes)
        for i, seed in enumerate(seeds):
            random = torch.Generator().manual_seed(seed)
            for weights in self.weights:
                for gate in weights.data[i].chunk(3, 1):
                    nn.init.orthogonal_(gate, generator=random)
            self.biases[0].data[i, 0, UNITS : 2 * UNITS] = torch.linspace(-1.0, 5.0, UNITS)  # they keep for up to 1.5 s

    def forward(self, inputs: Tensor, last: Tensor) -> Tensor:
        """Return inputs of shape (networks, n, `LAB_SIZE`) with the next units in their places."""
        read = torch.baddbmm(self.biases[0], inputs[..., READ], self.weights[0]).chunk(3, 2)
        kept = torch.baddbmm(self.biases[1], last, self.weights[1]).chunk(3, 2)
        resets, keeps = (torch.sigmoid(read[i] + kept[i]) for i in range(2))
        new = torch.tanh(read[2] + resets * kept[2])
        return inputs.index_copy(2, torch.from_numpy(PLACES), new + keeps * (last - new))


class RecurrentNetworks(Networks):
    """Networks with units."""

    def __init__(self, seeds: list[int]) -> None:
        super().__init__(seeds, [])
        self.near, self.units = FOLLOWING, Units(seeds)


class RecurrentTrainer(Trainer):
    """The training of networks with units."""

    networks: RecurrentNetworks

    def __init__(self, args: argparse.Namespace) -> None:
        super().__init__(args, RecurrentNetworks(args.seeds))
        self.flight.memory = self.flight.zeros(len(self.flight.memory) + UNITS, self.flight.rows)
        self.remembered: list[Tensor] = []  # the units before each step of a window of imitation

    def inputs(self, seen: Tensor, action: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the inputs of the networks and their memory."""
        flight = self.flight
        found, after = flight.inputs(seen, action, memory[:-UNITS])
        last = flight.for_networks(memory[-UNITS:])
        if not torch.is_grad_enabled():
            self.remembered.append(last)
        inputs = flight.for_rows(self.networks.units(flight.for_networks(found), last))
        return inputs, torch.cat([after, inputs[PLACES]])

    def fit(self, inputs: list[Tensor], labels: list[Tensor]) -> None:
        """Fit networks and units to outputs in some steps, shapes (networks, rows of one, k)."""
        order = torch.rand(inputs[0].shape[1]).argsort()
        for part in order[: len(order) // BATCHES * BATCHES].view(BATCHES, -1):
            units, losses = self.remembered[0][:, part], []
            for x, y, last in zip(inputs, labels, self.remembered, strict=True):
                begun = (last[:, part] == 0.0).all(2, keepdim=True)
                found = self.networks.units(x[:, part], torch.where(begun, 0.0, units))
                units = found[..., PLACES]
                losses.append(imitation_loss(self.networks(found), y[:, part]))
            self.descend(torch.stack(losses).mean(0))
        self.remembered = []


@settings
class RecurrentLab(LabOnly):
    """Hybrid of a network with units."""

    kind: ClassVar[str] = "recurrent_lab"
    feedback: bool = False
    units: Any = None

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        (part,) = super().parts(size)

        def read(_: None, seen: Seen, memory: Any) -> tuple[Any, Any]:
            found, after = part.function(part.numbers, seen, memory[:, :-UNITS])
            given = (torch.from_numpy(item.astype(np.float32))[None] for item in (found, memory[:, -UNITS:]))
            with torch.no_grad():
                inputs = self.units(*given)[0].numpy()
            return inputs, np.concatenate([after, inputs[:, PLACES]], axis=1)

        return (InputPart(part.size, part.memory_size + UNITS, read, None),)


def recurrent(networks: RecurrentNetworks, policies: list[MlpPolicy]) -> list[MlpPolicy]:
    """Give the policies of networks their units."""
    for i, policy in enumerate(policies):
        units = Units([0])
        units.load_state_dict({name: value[i : i + 1] for name, value in networks.units.state_dict().items()})
        policy.hybrid = RecurrentLab(units=units)
    return policies


def trained(name: str) -> list[MlpPolicy]:
    """Return the networks of a row, which are trained or read from the folder of their training."""
    given = "--device", "c", "--seeds", *map(str, SEEDS), "--kernels", str(RUNS / "kernels")
    args = parse([*given, "--out", str(RUNS / name.replace(" ", "-")), *ROWS[name]])
    if not name.startswith("gru"):
        return Trainer(args, Networks(args.seeds, args.without)).train()
    trainer = RecurrentTrainer(args)
    return recurrent(trainer.networks, trainer.train())


def main() -> None:
    """Train what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[*ROWS], metavar="NAME", help=f"rows: {', '.join(ROWS)}")
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = []
    for name in given.names:
        policies = trained(name)
        gentle, events = (
            compare({name: policies}, [part], 24, VALIDATION_SEED).ranking[0] for part in ("flight", "events")
        )
        steps, seconds = (policies[0].card[item] for item in ("steps", "seconds"))
        numbers = map(format_interval, (gentle.multiple, gentle.survival, events.survival))
        table.append([name, f"{1e-6 * steps:.1f}", f"{seconds / 60:.0f}", *numbers])
    headings = "million steps", "minutes for three", "multiple", "survival, gentle (%)", "survival, events (%)"
    print(markdown_table(["training", *headings], table))


if __name__ == "__main__":
    main()
