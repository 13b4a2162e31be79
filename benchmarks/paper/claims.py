"""Statements of the paper, and separately our own, compared with numbers.

A criterion is a condition computed from the data, either for every draw of random starts or for the mean over draws.
The verdict on a claim follows from its criteria alone. Criteria of our own that are stricter than the statement are
shown, but do not affect the verdict.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

#: All criteria hold; some hold somewhere; none holds anywhere; none can be judged; none holds because we are better.
VERDICTS = ("agrees", "agrees in part", "does not agree", "cannot be decided", "is exceeded")
#: The same for a sentence of ours, which has nobody to agree with.
OURS = ("holds", "holds in part", "does not hold", "cannot be decided", "is exceeded")


@dataclass(frozen=True)
class Criterion:
    """A condition in words, and in how many of the draws it holds.

    Attributes
    ----------
    text : str
    held, draws : int
        No draws: it cannot be decided.
    ours : bool
        Whether it is stricter than the paper's sentence, so that the verdict does not depend on it.
    """

    text: str
    held: int
    draws: int
    ours: bool = False

    @classmethod
    def of(cls, text: str, outcomes: bool | Iterable[bool], ours: bool = False) -> Criterion:
        """Count outcomes: one, or one for each draw."""
        found = [bool(o) for o in (outcomes if isinstance(outcomes, Iterable) else [outcomes])]
        if not found:
            raise ValueError(f"a criterion needs an outcome: {text}")
        return cls(text, sum(found), len(found), ours)

    @classmethod
    def mean(cls, text: str, values: Sequence[float], low: float, high: float) -> Criterion:
        """Judge whether the mean over the draws lies between two values, within two standard errors."""
        mean, error = np.mean(values), np.std(values, ddof=1) / np.sqrt(len(values))
        met = low - 2.0 * error <= mean <= high + 2.0 * error
        words = f"{text}, on average over {len(values)} draws, within two standard errors: {mean:.1f} ± {error:.1f}"
        return cls(words, int(met), 1)

    @classmethod
    def undecided(cls, text: str) -> Criterion:
        """Name a condition that the paper or the measurement leaves open."""
        return cls(text, 0, 0)

    @property
    def met(self) -> bool:
        """Whether it holds in all draws."""
        return 0 < self.draws == self.held

    def __str__(self) -> str:
        """Return the condition and its outcome for people."""
        if self.draws < 2:
            return f"{self.text} ({('not met', 'met')[self.held] if self.draws else 'cannot be decided'})"
        return f"{self.text} (met in {self.held} of {self.draws} draws)"


@dataclass(frozen=True)
class Claim:
    """A sentence, our numbers, and the criteria by which it is judged.

    Attributes
    ----------
    sentence : str
    numbers : str
    criteria : tuple of Criterion
        Empty if the claim cannot be decided; then `numbers` says why.
    ours : bool
        Whether the sentence is ours and not the paper's.
    exceeded : Criterion, optional
        That our errors are smaller, if this is why no criterion is met.
    """

    sentence: str
    numbers: str
    criteria: tuple[Criterion, ...] = ()
    ours: bool = False
    exceeded: Criterion | None = None

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`, or of `OURS`."""
        words = OURS if self.ours else VERDICTS
        deciding = [c for c in self.criteria if not c.ours]
        if not any(c.draws for c in deciding):
            return words[3]
        if all(c.met for c in deciding):
            return words[0]
        if any(c.held for c in deciding):
            return words[1]
        return words[4] if self.exceeded and self.exceeded.met else words[2]


def entry(claim: Claim) -> str:
    """Return a claim in markdown: the sentence with its verdict, our numbers, and each criterion with its outcome."""
    lines = [f"- *{claim.sentence}* **{capitalised(claim.verdict)}.**", f"  - Measured: {claim.numbers}"]
    lines += [f"  - {'Stricter criterion of ours' if c.ours else 'Criterion'}: {c}." for c in claim.criteria]
    return "\n".join(lines + ([f"  - Exceeded: {claim.exceeded}."] if claim.exceeded else []))


def capitalised(verdict: str) -> str:
    """Return a verdict as the beginning of a sentence."""
    return "Exceeded" if verdict == VERDICTS[4] else verdict[0].upper() + verdict[1:]


def summary(claims: list[tuple[str, Claim]]) -> str:
    """Count the verdicts, the paper's claims and ours separately, and list by page those of claims that do not agree.

    Parameters
    ----------
    claims : list of (where it is judged, Claim)
    """
    papers, ours = ([c for c in claims if c[1].ours is own] for own in (False, True))
    lines = [f"Of {len(papers)} claims of the paper, {_counted(papers, VERDICTS)}."]
    lines += (
        [f"Of {len(ours)} sentences of our own, which make claims beyond the paper, {_counted(ours, OURS)}."]
        if ours
        else []
    )
    lines += ["", "| where | claims | agree | other verdicts |", "| --- | --- | --- | --- |"]
    for place in dict.fromkeys(place for place, _ in papers):
        here = [claim for where, claim in papers if where == place]
        others = [claim for claim in here if claim.verdict != VERDICTS[0]]
        words = "; ".join(f"{claim.sentence.rstrip('.')}: **{capitalised(claim.verdict).lower()}**" for claim in others)
        lines.append(f"| {place} | {len(here)} | {len(here) - len(others)} | {words} |")
    return "\n".join(lines) + "\n"


def _counted(claims, words):
    counts = Counter(c.verdict for _, c in claims)
    parts = [f"{counts[word]} {_plural(word, counts[word])}" for word in words if counts[word]]
    return ", ".join(parts[:-1]) + (" and " if len(parts) > 1 else "") + parts[-1]


def _plural(verdict, n):
    """Return "agrees in part", or "agree in part" if n is not 1."""
    plural = {"agrees": "agree", "holds": "hold", "does": "do", "cannot": "cannot", "is": "are"}
    first, _, rest = verdict.partition(" ")
    return f"{first if n == 1 else plural[first]} {rest}".strip()
