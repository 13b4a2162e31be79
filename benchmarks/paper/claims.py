"""Sentences that are put beside numbers: of the paper, and, counted apart, our own.

A criterion is a condition computed from the data, judged for every draw of random starts where chance plays a part. The
verdict on a claim follows from its criteria and from nothing else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

#: All criteria hold in all draws; some hold somewhere; none holds anywhere; there is none that can be judged.
VERDICTS = ("agrees", "agrees in part", "does not agree", "cannot be decided")
#: The same four for a sentence of ours, which has nobody to agree with.
OURS = ("holds", "holds in part", "does not hold", "cannot be decided")


@dataclass(frozen=True)
class Criterion:
    """A condition in words, and in how many of the draws it holds."""

    text: str
    held: int
    draws: int

    @classmethod
    def of(cls, text: str, outcomes: bool | Iterable[bool]) -> Criterion:
        """Count outcomes: one, or one for each draw."""
        found = [bool(o) for o in (outcomes if isinstance(outcomes, Iterable) else [outcomes])]
        if not found:
            raise ValueError(f"a criterion needs an outcome: {text}")
        return cls(text, sum(found), len(found))

    def __str__(self) -> str:
        """Return the condition and its outcome for people."""
        if self.draws == 1:
            return f"{self.text} ({'met' if self.held else 'not met'})"
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
    """

    sentence: str
    numbers: str
    criteria: tuple[Criterion, ...] = ()
    ours: bool = False

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`, or of `OURS`."""
        words = OURS if self.ours else VERDICTS
        if not self.criteria:
            return words[3]
        if all(c.held == c.draws for c in self.criteria):
            return words[0]
        return words[1] if any(c.held for c in self.criteria) else words[2]


def entry(claim: Claim) -> str:
    """Return a claim in markdown: the sentence with its verdict, our numbers, and each criterion with its outcome."""
    verdict = claim.verdict
    lines = [f"- *{claim.sentence}* **{verdict[0].upper()}{verdict[1:]}.**", f"  - Measured: {claim.numbers}"]
    return "\n".join(lines + [f"  - Criterion: {criterion}." for criterion in claim.criteria])


def summary(claims: list[tuple[str, Claim]]) -> str:
    """Count the verdicts, the paper's claims and ours apart, and list what does not agree in full.

    Parameters
    ----------
    claims : list of (title of its section, Claim)
    """
    papers, ours = ([c for c in claims if c[1].ours is own] for own in (False, True))
    lines = [f"Of {len(papers)} claims of the paper, {_counted(papers, VERDICTS)}."]
    lines += (
        [f"Of {len(ours)} sentences of our own, which go beyond the paper, {_counted(ours, OURS)}."] if ours else []
    )
    for own, words in ((False, VERDICTS), (True, OURS)):
        for verdict in words[1:]:
            found = [f"- {c.sentence} ({title})" for title, c in claims if c.ours is own and c.verdict == verdict]
            if found:
                whose = "Of our own, " if own else "Of the paper's claims, "
                lines += [f"\n{whose}{_plural(verdict, len(found))}:\n", *found]
    return "\n".join(lines) + "\n"


def _counted(claims, words):
    counts = Counter(c.verdict for _, c in claims)
    parts = [f"{counts[word]} {_plural(word, counts[word], noun=False)}" for word in words if counts[word]]
    return ", ".join(parts[:-1]) + (" and " if len(parts) > 1 else "") + parts[-1]


def _plural(verdict, n, noun=True):
    """Return "this one agrees in part" or "these agree in part", or the verb alone."""
    plural = {"agrees": "agree", "holds": "hold", "does": "do", "cannot": "cannot"}
    first, _, rest = verdict.partition(" ")
    verb = f"{first if n == 1 else plural[first]} {rest}".strip()
    return f"{'this one' if n == 1 else 'these'} {verb}" if noun else verb
