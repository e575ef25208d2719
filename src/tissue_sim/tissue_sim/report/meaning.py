"""What the figures of a session mean, and what they do and do not validate."""

from __future__ import annotations

MEANING = (
    "Time is simulated time, from the first to the last frame of the epoch. Positions are those of "
    "the tool's tip as the simulation used them, after clutch, scaling and limits of speed.",
    "Speed: central differences of positions that passed a low-pass at 10 Hz (Butterworth, second "
    "order, forwards and backwards). Path length is that of the unfiltered positions.",
    "Movement: at or above the idle speed (named above) for at least 0.2 s. Idle: below it, "
    "between the first and the last movement.",
    "Economy of motion: the distances between the ends of all movements over their ways; 1 is "
    "straight. Economy of volume: cube root of the volume of the box over the path length "
    "(Oropesa et al. 2013).",
    "SPARC: spectral arc length of the speed with adaptive cut-off, at most 10 Hz, 5 % of the "
    "spectrum (Balasubramanian et al. 2012, 2015). A minimum jerk movement has -1.41; the more "
    "negative, the less smooth. Over the whole session every stop counts as well.",
    "LDLJ: log dimensionless jerk of the speed (Balasubramanian et al. 2015); a minimum jerk "
    "movement has -5.32. It depends on noise and rate of sampling.",
    "Working volume: convex hull and box of the tip's places from the first to the last movement. "
    "For motion in a plane the hull has an area and no volume.",
    "Hands: Pearson's correlation of their speeds, and the share of the time in which both move "
    "while any does, as the simultaneous movement that Hofstad et al. (2013) call bimanual "
    "dexterity. Work in turns is not worse by itself: it depends on the task.",
    "Force: magnitude of tools/<tool>/measured_cf, what tissue does to the tool. Impulse: its "
    "integral over time.",
    "Stress: largest von Mises stress at a node, of linear isotropic tissue in the shape seen, "
    "some times a second; its integral by the trapezoidal rule. Sheets have the strain of their "
    "springs instead.",
    "Cuts, in the organ at rest: length of the longest line on the surface, area of one lip, mean "
    "depth area over length, depth the farthest point from that line (the wall's thickness where "
    "it is cut through). Deviation: root mean square and largest distance from the nearest plan; "
    "of lines, on the side of the wall that is nearer to it.",
    "Risk: warnings of risk regions from begin to end. Holes: what is covered as docs/closure.md "
    "defines it.",
)

RELIABILITY = (
    "Test-retest: each person's first and second session. r: Pearson's correlation. ICC(2,1): "
    "absolute agreement of single scores; ICC(3,1): consistency, which a common gain by practice "
    "does not lower (Shrout and Fleiss 1979; intervals of 95 % after McGraw and Wong 1996). SEM: "
    "standard error of measurement. Limits: mean difference, second less first, and the range of "
    "95 % of differences (Bland and Altman 1986).",
    "Inter-rater: people's scores of the same sessions. Kappa: Cohen's with quadratic weights, "
    "for whole grades of two raters. Figures computed from a recording have no rater: two "
    "computations agree exactly.",
    "Read an ICC by its interval, not by its value, and for people like those who were measured "
    "(Koo and Li 2016). With fewer than about 30 persons and 3 raters the interval is wide.",
    "Known groups: median of each person's sessions, then of the group. Cliff's delta: share of "
    "pairs in which the expert's value is larger less those in which it is smaller; 0: no "
    "difference, 1 or -1: no overlap. Nothing here says which direction is better.",
)

VALIDITY = (
    ("face", "Do experts find the test appropriate when they look at it?",
     "Nothing. Ask experts; this page is something to show them."),
    ("content", "Do its contents cover what the situation asks for?",
     "Nothing. It lists what was measured, so that experts can see what was not."),
    ("construct", "Does the test capture the quality it claims to measure?",
     "Differences between known groups, where experts and trainees are marked. A difference is "
     "necessary, not sufficient: other things than skill may differ."),
    ("concurrent", "Do scores relate to performance that was evaluated at real work?",
     "Nothing. It needs such an evaluation of the same people; the JSON beside this page holds the "
     "figures to correlate with it."),
    ("predictive", "Do scores predict later performance?",
     "Nothing. It needs the people's later performance."),
)  # fmt: skip
"""Kind of validity (the thesis' appendix C.1), what it asks, and what this page adds to it."""

LIMITS = (
    "There are no thresholds of competence here, and none may be read into these figures: no score "
    "on this page says that somebody can or cannot operate.",
    "None of this validates the mechanics of the tissue. Stress, force and closure are those of "
    "the model that ran, with its material and mesh.",
    "Figures compare only within one task on one organ, with the same input device, model and "
    "rates. Sessions on other organs are not put side by side.",
    "A figure that is missing was not recorded or has no meaning; it is never taken for 0.",
    "Research software: nothing here is validated for assessment of people or for clinical use.",
)
