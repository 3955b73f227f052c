"""Coloured noise: linear filters of white noise, sampled exactly.

    (1)  ẋ = A x + B n,   y = C x          n: independent white noises with E[n(t) n(t')ᵀ] = δ(t − t') I
    (2)  x_{k+1} = Φ x_k + L w_k           w: standard normal, Φ = e^{A T},  L Lᵀ = ∫₀ᵀ e^{A s} B Bᵀ e^{Aᵀ s} ds
    (3)  x_0 = S w,   S Sᵀ = P             A P + P Aᵀ + B Bᵀ = 0: stationary from the first sample on

(2) is exact at the samples for every period T (Van Loan, IEEE Trans. Automatic Control 23(3), 1978), so deviation,
spectrum and correlation do not depend on the step size.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import Keys, Streams, normal_pair


@dataclass(frozen=True)
class Filter:
    """A linear system (1).

    Attributes:
        a: A, 1/s, shape (m, m).
        b: B, shape (m, j).
        c: C, shape (k, m).
    """

    a: Floats
    b: Floats
    c: Floats

    @property
    def stationary(self) -> Floats:
        """P of equation (3), shape (m, m)."""
        return np.asarray(solve_continuous_lyapunov(self.a, -self.b @ self.b.T))


def transfer(numerator: list[float], denominator: list[float], gain: float, time: float) -> Filter:
    """The filter gain · N(s time)/D(s time), driven by white noise of one-sided density 1 (per rad/s).

    That is the convention of the military specifications, whose variance is ∫₀^∞ Φ(ω) dω: such a noise has
    E[n(t) n(t')] = π δ(t − t').

    Args:
        numerator: coefficients of N, constant first, fewer than those of D.
        denominator: coefficients of D, constant first.
        gain: see above.
        time: s.
    """
    order = len(denominator) - 1
    a = np.eye(order, k=1)
    a[-1] = -np.array(denominator[:-1]) / denominator[-1]
    c = np.zeros((1, order))
    c[0, : len(numerator)] = gain * np.array(numerator) / denominator[-1]
    # In units of `time` the poles are those of D; the noise is scaled so that C has the gain as it is given.
    return Filter(a / time, np.sqrt(np.pi) / time * np.eye(order)[:, -1:], c)


def side_by_side(filters: list[Filter]) -> Filter:
    """Independent filters as one."""
    return Filter(*(np.asarray(block_diag(*parts)) for parts in zip(*((f.a, f.b, f.c) for f in filters), strict=True)))


@dataclass(frozen=True)
class Sampled:
    """A filter at its samples (2): Φ and L, each of shape (m, m)."""

    transition: Floats
    root: Floats


def sample(system: Filter, period: float) -> Sampled:
    """The filter sampled every `period` seconds, by Van Loan's method."""
    size = system.a.shape[0]
    # Its exponential of −A grows without bounds: a period that is long against the system is reached by doubling.
    doublings = max(0, int(np.ceil(np.log2(period * np.abs(system.a).sum(axis=1).max()))))
    both = np.block([[-system.a, system.b @ system.b.T], [np.zeros((size, size)), system.a.T]])
    exponential = expm(both * period / 2**doublings)
    transition = exponential[size:, size:].T
    covariance = transition @ exponential[:size, size:]
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    return Sampled(transition, square_root(covariance))


def square_root(covariance: Floats) -> Floats:
    """The symmetric square root of a covariance that may be singular but for rounding.

    It is the one that does not depend on the eigenvectors' signs and order, which are a matter of rounding, and so of
    the machine.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(np.where(covariance == 0.0, 0.0, root))  # what is independent stays so to the bit


@inlined
def _fill_pair(keys: Any, index: Any, pairs: int, pair: int, one: Any, other: Any) -> None:
    for row in range(keys.size):
        one[row], other[row] = normal_pair(keys[row], index[row] * pairs + pair)


@inlined
def _add_product(matrix: Any, values: Any, i: int, out: Any) -> None:
    """Add row i of matrix · values to `out`, shape (n,)."""
    for j in range(values.shape[0]):
        if matrix[i, j] != 0.0:
            for row in range(out.size):
                out[row] += matrix[i, j] * values[j, row]


@compiled
def _run(
    keys: Keys,
    index: Integers,
    transition: Floats,
    root: Floats,
    output: Floats,
    axes: Integers,
    memory: Floats,
    out: Floats,
) -> None:
    size, rows = memory.shape
    pairs = (size + 1) // 2
    noise = np.empty((2 * pairs, rows))
    for pair in range(pairs):
        _fill_pair(keys, index, pairs, pair, noise[2 * pair], noise[2 * pair + 1])
    for i in range(axes.size):
        _add_product(output, memory, i, out[axes[i]])
    before = memory.copy()
    for i in range(size):
        memory[i] = 0.0
        _add_product(transition, before, i, memory[i])
        _add_product(root, noise[:size], i, memory[i])


@compiled
def _multiply(matrix: Floats, values: Floats, out: Floats) -> None:
    for i in range(matrix.shape[0]):
        _add_product(matrix, values, i, out[i])


def start(root: Floats, streams: Streams) -> Floats:
    """x_0 of equation (3), shape (n, m), drawn from block 0 of the streams; `root` is S, shape (m, m)."""
    normal = streams.normal(0, root.shape[0])
    # Not numpy's matrix product: its last bits depend on the number of rows.
    out = np.zeros(normal.T.shape)
    _multiply(root, normal.T, out)
    return out.T


def run(
    sampled: Sampled, output: Floats, axes: Integers, step: Integers, streams: Streams, memory: Floats, out: Floats
) -> None:
    """Add C x_k to columns of `out`, and go on to x_{k+1}.

    Args:
        sampled: Φ and L.
        output: C, shape (k, m).
        axes: the columns, shape (k,).
        step: k of each row, shape (n,).
        streams: of the rows; block `step + 1` is read.
        memory: x, shape (n, m), columns contiguous, changed in place.
        out: shape (n, ...), columns contiguous, changed in place.
    """
    _run(streams.keys, step + 1, sampled.transition, sampled.root, output, axes, memory.T, out.T)
