"""Coloured noise from linear filters of white noise, discretised exactly.

    (1)  ẋ = A x + B n,   y = C x          n: independent white noises with E[n(t) n(t')ᵀ] = δ(t − t') I
    (2)  x_{k+1} = Φ x_k + L w_k           w: standard normal, Φ = e^{A T},  L Lᵀ = ∫₀ᵀ e^{A s} B Bᵀ e^{Aᵀ s} ds
    (3)  x_0 = S w,   S Sᵀ = P             A P + P Aᵀ + B Bᵀ = 0: stationary from the first sample on

Equation (2) is exact at the samples for every period T (Van Loan, IEEE Trans. Automatic Control 23(3), 1978).
Standard deviation, spectrum and correlation therefore do not depend on the period.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import Keys, Streams, normal_pair


class Filter(NamedTuple):
    """A filter in continuous time, equation (1)."""

    a: Floats  # A, 1/s, shape (m, m)
    b: Floats  # B, shape (m, j)
    c: Floats  # C, shape (k, m)

    @property
    def stationary_covariance(self) -> Floats:
        """Matrix P of equation (3), shape (m, m)."""
        return np.asarray(solve_continuous_lyapunov(self.a, -self.b @ self.b.T))


def from_transfer_function(numerator: list[float], denominator: list[float], gain: float, time: float) -> Filter:
    """Return the filter gain · N(s time)/D(s time) of white noise with the one-sided density 1 (per rad/s).

    The military specifications define one-sided densities Φ(ω) with the variance ∫₀^∞ Φ(ω) dω. With this definition,
    white noise of density 1 has E[n(t) n(t')] = π δ(t − t').

    The coefficients of N, fewer than those of D, and of D have the constant first.
    """
    order = len(denominator) - 1
    a = np.eye(order, k=1)
    a[-1] = -np.array(denominator[:-1]) / denominator[-1]
    c = np.zeros((1, order))
    c[0, : len(numerator)] = gain * np.array(numerator) / denominator[-1]
    # The poles of A · time are the roots of D. B contains the scale of the noise, and C the gain.
    return Filter(a / time, np.sqrt(np.pi) / time * np.eye(order)[:, -1:], c)


def combine(filters: list[Filter]) -> Filter:
    """Return one filter that consists of independent filters."""
    return Filter(*(np.asarray(block_diag(*parts)) for parts in zip(*filters, strict=True)))


class DiscreteFilter(NamedTuple):
    """The state equation of a filter in discrete time, equation (2)."""

    transition: Floats  # Φ, shape (m, m)
    noise_gain: Floats  # L, shape (m, m)


def discretise(system: Filter, period: float) -> DiscreteFilter:
    """Discretise a filter with a sampling period in s, by Van Loan's method."""
    size = system.a.shape[0]
    # Van Loan's method computes exp(−A T), which overflows for large T. The period is therefore halved until T is small
    # enough, and the result is doubled as often.
    doublings = max(0, int(np.ceil(np.log2(period * np.abs(system.a).sum(axis=1).max()))))
    block = np.block([[-system.a, system.b @ system.b.T], [np.zeros((size, size)), system.a.T]])
    exponential = expm(block * period / 2**doublings)
    transition = exponential[size:, size:].T
    covariance = transition @ exponential[:size, size:]
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    return DiscreteFilter(transition, square_root(covariance))


def square_root(covariance: Floats) -> Floats:
    """Return the symmetric square root of a covariance matrix, which may be singular up to rounding errors.

    The symmetric square root does not depend on the signs and the order of the eigenvectors, which rounding errors
    determine and which can differ between machines.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(np.where(covariance == 0.0, 0.0, root))  # independent components stay exactly independent


@inlined
def _fill_pair(keys: Any, index: Any, pairs: int, pair: int, first: Any, second: Any) -> None:
    for row in range(keys.size):
        first[row], second[row] = normal_pair(keys[row], index[row] * pairs + pair)


@inlined
def _add_product(matrix: Any, values: Any, i: int, out: Any) -> None:
    """Add row i of the product matrix · values to `out`, shape (n,)."""
    for j in range(values.shape[0]):
        if matrix[i, j] != 0.0:
            for row in range(out.size):
                out[row] += matrix[i, j] * values[j, row]


@compiled
def _advance(
    keys: Keys,
    index: Integers,
    transition: Floats,
    noise_gain: Floats,
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
        _add_product(noise_gain, noise[:size], i, memory[i])


@compiled
def _multiply(matrix: Floats, values: Floats, out: Floats) -> None:
    for i in range(matrix.shape[0]):
        _add_product(matrix, values, i, out[i])


def draw_stationary(root: Floats, streams: Streams) -> Floats:
    """Draw x_0 of equation (3), shape (n, m), from block 0 of n random streams; `root` is S, shape (m, m)."""
    normal = streams.normal(0, root.shape[0])
    # The last bits of NumPy's matrix product depend on the number of rows, so it is not used here.
    out = np.zeros(normal.T.shape)
    _multiply(root, normal.T, out)
    return out.T


def advance(
    system: DiscreteFilter,
    output: Floats,
    axes: Integers,
    step: Integers,
    streams: Streams,
    memory: Floats,
    out: Floats,
) -> None:
    """Add the output C x_k, shape (n, k), to the columns `axes` of `out`, and replace x_k in `memory` by x_{k+1}.

    The columns of `memory`, shape (n, m), and of `out` are contiguous. Block `step + 1` of the random streams is used.
    """
    _advance(streams.keys, step + 1, system.transition, system.noise_gain, output, axes, memory.T, out.T)
