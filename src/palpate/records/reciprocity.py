"""Outcome of the test of reciprocity: whether the pushes on a held body agree with each other,
whatever the body is made of."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WorkPair:
    """Two pushes, and the work of each one's force in the motion that the other makes.

    Parameters
    ----------
    first, second : str             names of the probings
    work : float [J]                of the second's force in the motion under the first
    other : float [J]               of the first's force in the motion under the second: the same,
                                    by reciprocity
    std : float [J]                 one standard deviation of their difference
    """

    first: str
    second: str
    work: float
    other: float
    std: float

    @property
    def sigmas(self) -> float:
        """Difference of the two works in standard deviations."""
        return (self.work - self.other) / self.std


@dataclass(frozen=True, slots=True)
class ForceExcess:
    """By how much a force is larger than the other pushes say.

    Parameters
    ----------
    name : str                      of the probing
    excess : float [-]              of the force, relative
    std : float [-]                 one standard deviation, if nothing were known of its size
    sigmas : float                  in standard deviations, those of the force included; its square
                                    is what chi-square falls by if the size of the force is free
    """

    name: str
    excess: float
    std: float
    sigmas: float


@dataclass(frozen=True, slots=True)
class Reciprocity:
    """How well pushes obey Betti's law of reciprocity.

    Parameters
    ----------
    pairs : tuple of WorkPair       pairs that could be tested
    pushes : tuple of ForceExcess   pushes of these pairs
    chi_square : float              over the pairs, which share forces, contacts and displacements
    degrees : int                   of freedom; 0: nothing could be tested
    chance : float                  probability of so large a chi-square where the law holds
    growth : ForceExcess or None    excess of the largest force if excess grows in proportion to the
                                    force, as where the material stiffens; None: forces are alike
    odd : tuple of str              pushes of which one has a wrong force; empty: all agree, or no
                                    single force explains why they do not; where the law holds,
                                    one that is suspicious
    grows : bool                    whether motion that is not in proportion to the force may be why
    holds : bool                    False: the law is broken, by chance in less than 1 of 200 sound
                                    sessions
    own_work : float [-]            least work of any mixture of forces in its own motion, over that
                                    of the same forces apart; NaN where no contact's own motion was
                                    measured
    own_work_std : float [-]
    passive : tuple of str          pushes that this covers
    untested : tuple of str         what could not be tested and why, in sentences
    """

    pairs: tuple[WorkPair, ...]
    pushes: tuple[ForceExcess, ...]
    chi_square: float
    degrees: int
    chance: float
    growth: ForceExcess | None
    odd: tuple[str, ...]
    grows: bool
    holds: bool
    own_work: float = math.nan
    own_work_std: float = math.nan
    passive: tuple[str, ...] = ()
    untested: tuple[str, ...] = ()

    @property
    def is_tested(self) -> bool:
        """True if there are pairs to judge by."""
        return self.degrees > 0

    @property
    def is_unexplained(self) -> bool:
        """Whether the law is broken, and neither one force nor stiffening explains why."""
        return not (self.holds or self.odd or self.grows)

    @property
    def text(self) -> str:
        """The outcome in one sentence or two, for the user."""
        if not self.is_tested:
            return " ".join(("Reciprocity cannot be tested.", *self.untested))
        count = f"{len(self.pairs)} pair{'s' * (len(self.pairs) > 1)} of pushes"
        figures = f"chi-square {self.chi_square:.3g} for {self.degrees}"
        if self.holds:
            suspicion = f" But one stands out. {self._cause()}" if self.odd else ""
            return (
                f"Whatever the material, {count} agree by reciprocity ({figures} degrees of"
                f" freedom, p = {self.chance:.2g}).{suspicion}"
            )
        head = f"Whatever the material, pushes contradict each other: {count}, {figures} degrees"
        return f"{head} of freedom, p = {self.chance:.1g}. {self._cause()}"

    def _cause(self) -> str:
        """What may have broken the law."""
        if self.grows and self.growth is not None and not self.odd:
            more, means = "less", "the material stiffens, or strains are large"
            if self.growth.excess < 0.0:
                more, means = "more", "the material softens, or tools slip"
            return (
                f"The larger the force, the {more} it moves than in proportion, by"
                f" {100.0 * abs(self.growth.excess):.2g} % at the largest: {means}."
            )
        excess_of = {push.name: push for push in self.pushes}
        if len(self.odd) == 1 and not self.grows:
            push = excess_of[self.odd[0]]
            side = "more" if push.excess > 0.0 else "less"
            return (
                f"It is {push.name}: {100.0 * abs(push.excess):.3g} %"
                f" (+- {100.0 * push.std:.2g}) {side} force is stated than its effect on the"
                " others says; look for a gain of its gauge, a tool that slipped, or creep between"
                " reading and picture."
            )
        if self.odd:
            names, also = ", ".join(self.odd), ", or motion out of proportion to force,"
            return (
                f"A wrong force in {'one of ' * (len(self.odd) > 1)}{names}{also * self.grows}"
                " explains it; the pairs cannot tell which."
            )
        return (
            "No single force explains it: a contact may lie elsewhere than stated, a tool have"
            " slipped, the support have moved, or the body not be elastic."
        )
