"""Named structures of a plant element: which parameters it has, and how it depends on them.

G(s) = (g1 e^(-theta1 s) + g2 e^(-theta2 s) + ...) prod (lead s + 1)
       / (s^m prod (tau s + 1) prod (s^2/omega0^2 + 2 zeta s/omega0 + 1))
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.errors import FormulaError
from trueplant.lti import element, levels
from trueplant.lti.element import Counts
from trueplant.lti.sampled import Hold, flags_of
from trueplant.lti.transfer import Term, TransferFunction

_BASES = {"gain": (0, 0), "fopdt": (1, 0), "sopdt": (2, 0), "integrator": (0, 1), "pair": (0, 0)}


@dataclass(frozen=True)
class Block:
    """Value and gradient of one delayed term: rows of numerators over one denominator, one dead time."""

    num: Array
    """(1 + number of rows, n + 1): first the term itself."""
    den: Array
    dead_time: float
    index: tuple[int, ...]
    """The parameter that each further row is the derivative by."""


@dataclass(frozen=True)
class Structure:
    """How many of each factor an element has. Parameters are ordered as `names`; `is_gain` and the masks beside it tell
    of which kind each is."""

    lags: int = 1
    leads: int = 0
    pairs: int = 0
    integrators: int = 0
    delayed: int = 1

    @classmethod
    def parse(cls, text: str) -> Structure:
        """From a name such as "fopdt", "sopdt+lead", "integrator+lag", "pair+lead", "sopdt+delayed"."""
        base, *extras = [part.strip().lower() for part in text.split("+")]
        if base not in _BASES:
            raise FormulaError(f"unknown structure {text!r}: begin with one of {', '.join(_BASES)}")
        counts = {"lag": _BASES[base][0], "lead": 0, "pair": int(base == "pair"), "integrator": _BASES[base][1]}
        counts["delayed"] = 1
        for extra in extras:
            if extra not in counts:
                raise FormulaError(f"unknown part {extra!r} of structure {text!r}: use {', '.join(counts)}")
            counts[extra] += 1
        structure = cls(counts["lag"], counts["lead"], counts["pair"], counts["integrator"], counts["delayed"])
        if structure.relative_degree < 0:
            raise FormulaError(f"structure {text!r} is improper: it has more leads than lags")
        return structure

    def __str__(self) -> str:
        lags = self.lags
        if self.integrators:
            parts, integrators, pairs = ["integrator"], self.integrators - 1, self.pairs
        elif lags:
            parts, integrators, pairs = ["sopdt" if lags > 1 else "fopdt"], 0, self.pairs
            lags -= min(lags, 2)
        elif self.pairs:
            parts, integrators, pairs = ["pair"], 0, self.pairs - 1
        else:
            parts, integrators, pairs = ["gain"], 0, 0
        extras = (("integrator", integrators), ("lag", lags), ("pair", pairs), ("lead", self.leads))
        for name, count in (*extras, ("delayed", self.delayed - 1)):
            parts += [name] * count
        return "+".join(parts)

    @property
    def relative_degree(self) -> int:
        return self.lags + 2 * self.pairs + self.integrators - self.leads

    @property
    def has_dead_time(self) -> bool:
        """A held input has no derivative by dead time where the element answers a jump with a jump."""
        return self.relative_degree > 0

    @cached_property
    def names(self) -> tuple[str, ...]:
        gain = "slope" if self.integrators else "gain"

        def numbered(name: str, count: int) -> list[str]:
            return [name] if count == 1 else [f"{name}{k + 1}" for k in range(count)]

        names = numbered(gain, self.delayed) + [f"tau{k + 1}" for k in range(self.lags)]
        for k in range(self.pairs):
            names += ["omega0", "zeta"] if k == 0 else [f"omega0_{k + 1}", f"zeta_{k + 1}"]
        names += [f"lead{k + 1}" for k in range(self.leads)]
        return tuple(names + (numbered("dead_time", self.delayed) if self.has_dead_time else []))

    def _slices(self) -> tuple[slice, slice, slice, slice, slice]:
        g = self.delayed
        t = g + self.lags
        p = t + 2 * self.pairs
        z = p + self.leads
        return slice(0, g), slice(g, t), slice(t, p), slice(p, z), slice(z, len(self.names))

    def _mask(self, part: slice) -> BoolArray:
        mask = np.zeros(len(self.names), dtype=bool)
        mask[part] = True
        mask.flags.writeable = False
        return mask

    @cached_property
    def is_gain(self) -> BoolArray:
        """(n_p,) the gains; slopes where the element integrates."""
        return self._mask(self._slices()[0])

    @cached_property
    def is_lag(self) -> BoolArray:
        """(n_p,) the time constants of real poles."""
        return self._mask(self._slices()[1])

    @cached_property
    def is_frequency(self) -> BoolArray:
        """(n_p,) the natural frequencies of complex pairs; the damping follows each."""
        pairs = self._slices()[2]
        return self._mask(slice(pairs.start, pairs.stop, 2))

    @cached_property
    def is_damping(self) -> BoolArray:
        """(n_p,) the damping ratios of complex pairs."""
        pairs = self._slices()[2]
        return self._mask(slice(pairs.start + 1, pairs.stop, 2))

    @cached_property
    def is_lead(self) -> BoolArray:
        """(n_p,) the time constants of zeros."""
        return self._mask(self._slices()[3])

    @cached_property
    def is_dead_time(self) -> BoolArray:
        """(n_p,)"""
        return self._mask(self._slices()[4])

    def parameters(
        self,
        gain: ArrayLike,
        lag: ArrayLike,
        frequency: ArrayLike,
        damping: ArrayLike,
        lead: ArrayLike,
        dead_time: ArrayLike,
    ) -> Array:
        """Parameters (n_p,) put together by kind: each argument is one number for all of a kind, or one each."""
        p = np.empty(len(self.names))
        kinds = (self.is_gain, self.is_lag, self.is_frequency, self.is_damping, self.is_lead, self.is_dead_time)
        for kind, value in zip(kinds, (gain, lag, frequency, damping, lead, dead_time), strict=True):
            p[kind] = value
        return p

    def sizes(self, p: Array, lag: float) -> Array:
        """(n,) what a share of each parameter is a share of: itself, with the `lag` for dead times and leads."""
        return np.asarray(np.abs(p) + np.where(self.is_dead_time | self.is_lead, lag, 0.0))

    def lag(self, p: Array) -> float:
        """Sum of the lags: how long the element takes to answer, without its dead time."""
        return float(np.sum(p[self.is_lag]) + np.sum(1 / p[self.is_frequency]))

    def longest_dead_time(self, p: Array) -> float:
        """The longest dead time; 0 without one."""
        return float(np.max(p[self.is_dead_time], initial=0.0))

    def units(self, output_unit: str, input_unit: str, time_unit: str) -> tuple[str, ...]:
        """The unit of each parameter, in the order of `names`."""
        gain = gain_unit(output_unit, input_unit)
        units = np.full(len(self.names), time_unit, dtype=object)
        units[self.is_gain] = gain_unit(gain, time_unit) if self.integrators else gain
        units[self.is_frequency] = f"rad/{time_unit}" if time_unit else ""
        units[self.is_damping] = ""
        return tuple(units)

    @cached_property
    def _counts(self) -> Counts:
        """For the compiled functions of `element`."""
        dead_times = self.delayed if self.has_dead_time else 0
        return self.delayed, self.lags, self.pairs, self.leads, self.integrators, dead_times

    def polynomials(self, p: Array) -> tuple[Array, Array]:
        """Numerator and denominator without gains and dead times, descending powers."""
        num, den = element.polynomials(_contiguous(p), self._counts)
        return num, den

    def dead_times(self, p: Array) -> Array:
        return p[self._slices()[4]] if self.has_dead_time else np.zeros(self.delayed)

    def own_hold(self, hold: str) -> str:
        """The hold by which its response and derivatives are to be sampled.

        Of what has a dead time only the derivative by it passes on at once: the slope of the response in the sample.
        """
        return "zoh" if hold == "written" and self.has_dead_time else hold

    def _flags(self, hold: str) -> Hold:
        return flags_of(self.own_hold(hold))

    def response(self, p: Array, u: Array, h: float, hold: str = "zoh", every: int = 1) -> Array:
        """Sampled response to u (N,) from rest at each `every`-th sample: `sampled_response` of `transfer`."""
        y: Array = element.response(_contiguous(p), self._counts, _contiguous(u), h, self._flags(hold), every)
        return y

    def response_and_gradient(self, p: Array, u: Array, h: float, hold: str = "zoh", every: int = 1) -> Array:
        """(1 + n_p, n): the `response`, and its derivative by every parameter."""
        rows: Array = element.response_and_gradient(
            _contiguous(p), self._counts, _contiguous(u), h, self._flags(hold), every
        )
        return rows

    def transfer(self, p: Array) -> TransferFunction:
        """The transfer function with the parameters p."""
        num, den = self.polynomials(np.asarray(p, dtype=float))
        gains = p[self._slices()[0]]
        return TransferFunction(
            tuple(Term(tuple(g * num), tuple(den), t) for g, t in zip(gains, self.dead_times(p), strict=True))
        )

    def gradient_blocks(self, p: Array) -> Iterator[Block]:
        """One block for each delayed term, with the derivative by every parameter that it depends on."""
        rows, den = element.gradient_polynomials(_contiguous(p), self._counts)
        last = len(self.names) - self.delayed if self.has_dead_time else len(self.names)
        for k in range(self.delayed):
            index = [k, *range(self.delayed, last), *([last + k] if self.has_dead_time else [])]
            num, dead_time = element.delayed_term(_contiguous(p), self._counts, rows, k)
            yield Block(num, den, dead_time, tuple(index))

    def gradient(self, p: Array, s: ComplexArray) -> ComplexArray:
        """Derivative of the response at complex s (n_s,) by each parameter: (n_s, n_p)."""
        out = np.zeros((len(s), len(self.names)), dtype=complex)
        for block in self.gradient_blocks(p):
            common = np.exp(-block.dead_time * s) / np.polyval(block.den, s)
            for k, row in zip(block.index, block.num[1:], strict=True):
                out[:, k] += np.polyval(row, s) * common
        return out

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds: time constants, frequencies and damping above 0, dead times not below 0."""
        _, lags, pairs, _, dead = self._slices()
        low = np.full(len(self.names), -np.inf)
        low[lags] = low[pairs] = levels.LEAST_LAG
        low[dead] = 0.0
        return low, np.full(len(self.names), np.inf)

    def sorted(self, p: Array) -> NDArray[np.intp]:
        """Order of the parameters with tau1 >= tau2 >= ...: indices into p."""
        order = np.arange(len(p))
        lags = self._slices()[1]
        order[lags] = lags.start + np.argsort(-p[lags], kind="stable")
        return order

    def interchanged(self, p: Array) -> NDArray[np.intp]:
        """Indices into p in which plants that are the same have the same parameters.

        Poles and zeros of a kind come by size, delayed terms by their dead times.
        """
        order = self.sorted(p)
        gains, _, pairs, leads, delays = self._slices()
        order[leads] = leads.start + np.argsort(-p[leads], kind="stable")
        both = order[pairs].reshape(-1, 2)
        order[pairs] = both[np.argsort(p[self.is_frequency], kind="stable")].ravel()
        if self.has_dead_time:
            terms = np.argsort(p[delays], kind="stable")
            order[gains], order[delays] = gains.start + terms, delays.start + terms
        return order

    @property
    def time_scales(self) -> Array:
        """Exponent (n_p,) with which each parameter scales when time is stretched by a factor; dead time 0."""
        exponents = np.where(self.is_lag | self.is_lead, 1.0, 0.0)
        exponents[self.is_frequency | (self.is_gain if self.integrators else False)] = -1.0
        return exponents


def translated(own: Structure, values: Array, wanted: Structure) -> tuple[float, ...]:
    """Parameters of one structure as a start for another: shared names keep their values, new lags are short."""
    known = dict(zip(own.names, values, strict=True))
    dead_time = own.dead_times(values)[0]
    lag = own.lag(values) or dead_time or 1.0
    gains = np.where(np.arange(wanted.delayed) == 0, values[0], 0.0)
    shares = 10.0 * np.arange(1, wanted.lags + 1)
    if own.lags == 0:
        shares[:1] = 1.0
    new = wanted.parameters(gains, lag / shares, 1 / lag, 0.7, lag / 10, dead_time)
    return tuple(float(known.get(name, value)) for name, value in zip(wanted.names, new, strict=True))


def gain_unit(output_unit: str, input_unit: str) -> str:
    """Unit of output by input, with compound ones in brackets: "degC/%", "%/(lb/min)"; empty if neither has one."""

    def single(unit: str) -> str:
        bracketed = re.fullmatch(r"\([^()]*\)", unit)
        return f"({unit})" if re.search(r"[/*·\s]", unit) and not bracketed else unit

    return f"{single(output_unit or '1')}/{single(input_unit)}" if input_unit else output_unit


def _contiguous(x: Array) -> Array:
    return np.ascontiguousarray(x, dtype=float)


def structure_of(system: TransferFunction) -> tuple[Structure, Array]:
    """Structure and parameters of a transfer function.

    One that answers at once, but late, has a lag of 0 more: by samples of a held input, lag and dead time can only be
    told together.

    Raises FormulaError where it does not have the form of this module (other sums of delayed terms, zero
    pairs, poles in the right half-plane): such an element can be used, but not estimated.
    """
    if system.is_zero:
        raise FormulaError('a zero element has no structure: name one, for instance structure = "fopdt"')
    terms = system.terms
    if len({t.den for t in terms}) > 1:
        if len({t.dead_time for t in terms}) > 1:
            raise FormulaError(f"{system}: delayed terms with different denominators cannot be estimated")
        num: Array = np.zeros(1)
        den: Array = np.ones(1)
        for t in terms:
            num = np.asarray(np.polyadd(np.polymul(num, t.den), np.polymul(t.num, den)), dtype=float)
            den = np.asarray(np.polymul(den, t.den), dtype=float)
        terms = (Term(tuple(num), tuple(den), terms[0].dead_time),)
    first = np.array(terms[0].num)
    for t in terms[1:]:
        if len(t.num) != len(first) or not np.allclose(np.array(t.num) * first[0], first * t.num[0], rtol=1e-9):
            raise FormulaError(f"{system}: delayed terms that do not share their zeros cannot be estimated")
    zeros, poles = _clean_roots(first), _clean_roots(np.array(terms[0].den))
    if np.any(np.abs(zeros.imag) > 0) or np.any(zeros == 0):
        raise FormulaError(f"{system}: zeros that are complex or at s = 0 cannot be estimated")
    if np.any(poles.real > 0):
        raise FormulaError(f"{system}: an element that is unstable in open loop cannot be estimated")
    real = poles[(poles.imag == 0) & (poles.real < 0)].real
    upper = poles[poles.imag > 0]
    structure = Structure(
        lags=real.size,
        leads=zeros.size,
        pairs=upper.size,
        integrators=int(np.sum(poles == 0)),
        delayed=len(terms),
    )
    taus = np.sort(-1 / real)[::-1]
    if structure.relative_degree == 0 and any(t.dead_time > 0 for t in terms):
        structure, taus = replace(structure, lags=structure.lags + 1), np.append(taus, 0.0)
    pairs = np.column_stack([np.abs(upper), -upper.real / np.abs(upper)]).ravel()
    leads = np.sort(-1 / zeros.real)[::-1]
    # Each root r contributes (s - r) = -r (s/(-r) + 1), so the product of the -r belongs to the gain.
    scale = np.prod(-zeros.real) / np.real(np.prod(-poles[poles != 0]))
    gains = [t.num[0] * scale for t in terms]
    dead = [t.dead_time for t in terms] if structure.has_dead_time else []
    return structure, np.array([*gains, *taus, *pairs, *leads, *dead], dtype=float)


def _clean_roots(polynomial: Array) -> ComplexArray:
    """Roots with multiple ones put back together, as far as the polynomial is reproduced."""
    roots = np.roots(polynomial).astype(complex)
    if roots.size < 2:
        return roots
    for tolerance in (1e-1, 1e-2, 1e-3, 1e-6):
        cleaned = roots.copy()
        for k, root in enumerate(roots):
            near = np.abs(roots - root) <= tolerance * np.abs(root)
            mean = roots[near].mean()
            cleaned[k] = mean.real if abs(mean.imag) <= 1e-9 * abs(mean) else mean
        rebuilt = np.real(np.poly(cleaned)) * polynomial[0]
        if np.allclose(rebuilt, polynomial, rtol=1e-9, atol=1e-12 * np.max(np.abs(polynomial))):
            return cleaned
    return roots
