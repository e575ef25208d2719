"""What the figures of a report mean, in the words of its last section."""

from __future__ import annotations

MEANING = (
    "mean: the mean over the nodes of |x_target - x_reference|, averaged over the frames. All "
    "nodes count, fixed and held ones too; of a measured reference, those that were measured.",
    "of the worst: that over the same figure of tissue of which nothing moves but what is held. "
    "0: the same as the reference; 1: as far off as tissue that does not follow at all.",
    "95th percentile: of the nodes in a frame, averaged over the frames. largest: of any node in "
    "any frame.",
    "volume error: the volume of the target over that of the reference, less one; in the table "
    "the largest of any frame, without its sign.",
    "steps a frame: the model's own steps between two frames, their mean; fractions are carried "
    "over to the next frame. ms a frame: the median time of a step, times the steps of a frame, on "
    "the machine named above with whatever else ran on it; a reference that was computed before "
    "has the time it took then.",
    "lost: the state was not finite, or a node was farther away than 20 times the organ's size. "
    "From that frame on the target counts as tissue that does not follow.",
    "Held nodes are where they were recorded, for the reference and for every target alike: which "
    "nodes a grab takes does not depend on the model.",
)

LIMITS = (
    "Agreement with a model is not agreement with tissue. A model as reference is as good as its "
    "own law, material and mesh; only a measured reference says something about the organ that "
    "was measured, under what was done to it.",
    "The figures hold for this organ, mesh, interaction and effort. Another mesh or another pull "
    "can order the models differently.",
    "A target with parameters that were not fitted is judged with them, not at its best.",
    "Times are those of one run on one machine. Targets that were given time instead of steps "
    "come out differently elsewhere.",
    "Research software: nothing here is validated for clinical use.",
)

CITING = (
    "Name tissue_sim with its revision, the command and the organ's digest as they "
    "stand above; with them the figures can be computed again, bit for bit on the same machine "
    "where targets were given steps. result.json beside this page holds every number in SI units."
)
