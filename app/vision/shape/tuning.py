"""The numbers by which forms are fitted to a food. They are stored with each run, as `parameters.tuning`."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FormTuning:
    """Tuning of form_fit.py and shape.py, in the order in which a fit meets it; px are those of the working grid."""

    outline_sd_px: float = 0.7  # sd of an outline
    # the same for a form that lies beyond the loss's reach; other sds widen as much
    wide_outline_sd_px: float = 2.8
    outline_run_px: float = 10.0  # length along an outline over which its errors are one
    dense_sd_px: float = 0.5  # sd of the dense parallax
    dense_area_px: float = 100.0  # area over which errors of the dense parallax are one
    roughness_mm: float = 1.0  # sd of a food's surface about its form: skin, crumb, leaves; the dense parallax's in mm
    roughness_run_mm: float = 5.0  # length over which it is one
    # sd of parallax along a surface beside its noise: interpolation, gloss, poses
    surface_sd_px: float = 0.12
    max_sd_px: float = 1.0  # sd of parallax beyond which a point is left out
    # of an observation that could not be made: between a good one's and a bad one's
    unmeasured_loss: float = 2.0
    loss_scale: float = 2.5  # sds beyond which a misfit counts less and less (Cauchy)
    facing: float = 0.2  # cosine of the slant up to which parallax is compared in the first view
    facing_second: float = 0.15  # the same in the second view
    foot_mm: float = 0.5  # height over the support from which on a point is not the foot's
    # within its own outline: a crossing line there is hidden by the form itself
    hidden_px: float = 3.0
    # within the hull of its outline, up to which a point lies on the outline of the whole
    hull_px: float = 1.0
    near_px: float = 5.0  # from a point, beyond which it does not matter what the form covers
    min_outline: int = 8  # points of an outline below which it takes no part
    damping: tuple[float, float, float] = (
        0.1,
        1e-4,
        1e4,
    )  # Levenberg's damping: start, least, most
    tries: int = 5  # steps tried in a round
    remembered: int = 3  # rounds whose highest cost a step may not exceed
    patience_coarse: int = 1  # rounds without progress that end a coarse fit
    patience_fine: int = 3  # the same of a fine fit
    # relative fall of the cost that ends a coarse fit, which only ranks families
    converged_coarse: float = 1e-2
    converged_fine: float = 2e-3  # the same of a fine fit
    coverage_weight: float = 0.5  # of a point of the food's outline against one of the form's
    # from the form's outline, beyond which a point of the food's is not explained
    unexplained_px: float = 4.0
    first_rounds: int = 12  # rounds of a coarse fit
    wide_rounds: int = 6  # rounds of a fit with the wide outline
    rounds: int = 10  # rounds of a fine fit
    top_quantile: float = 0.98  # of the points' heights: strays lie above it
    margin_px: int = 25  # around a food's mask
    # forms nearest after the wide fit, which are fitted coarsely; a family may begin twice
    kept_coarse: int = 5
    kept: int = 4  # families that are fitted finely
    # of the best family's cost: one that fits so much worse coarsely is not fitted finely
    kept_ratio: float = 2.0
    # of a family in the average: below it, a family is fitted no further
    least_weight: float = 1e-4
    max_passes: int = 3  # fine fits along the best form, at most
    # relative change of the best volume in a pass below which no further one is needed
    settled: float = 0.03
    snap_px: float = 4.0  # across an outline, how far its edge is sought in the first view
    snap_second_px: float = 5.0  # the same in the second view
    second_weight: float = 0.5  # of the second view's outline, which was sought where the form was
    temper: float = 4.0  # by which differences of evidence count less: what no family can be errs alike all over a food
    # in the evidence, of the price of what had to be fitted: priors are wide
    occam_weight: float = 0.25
    touching_px: int = 7  # within which two foods' outlines are one
    in_front_mm: float = 2.0  # by which the farther of two touching foods may still seem nearer
    beyond_px: float = 3.0  # across an outline, where the other food is looked for
    support_unknown_mm: float = 1.5  # height of an unseen support over the table: a plate or none
    support_unknown_sd_mm: float = 2.0  # its sd
    least_support_sd_mm: float = 0.3  # of a seen support: crumbs, cloth
    # relative, of a volume: beyond it a bowl's inside would be imagined
    unknown_inside_sd: float = 0.25
    rest_sd: float = 0.02  # relative, of a volume: what families and their spreads leave out; chosen on 255 foods
    # the same of blocks and wedges, whose rounded edges and slopes are little seen
    flat_rest_sd: float = 0.036
    foot_sd_mm: float = 0.5  # of the foot, which a contact shadow hides: the flatter the food, the more of its height


TUNING = FormTuning()


@dataclass(frozen=True, slots=True)
class SingleTuning:
    """What differs where one view alone shows a food: its outline is all there is, and no food is of a family exactly.

    A height may not be read out of what is but the outline's own irregularity.
    """

    temper: float = 12.0  # as FormTuning's: one outline tells families apart by little else than its irregularities
    # of an outline: irregularities of a fiftieth of a food that spans 100 px
    outline_sd_px: float = 2.0
    kept: int = 9  # families that are fitted finely: one outline tells few of them apart
    # of the best family's cost, within which others are fitted finely, too
    kept_margin: float = 20.0
    rest_sd: float = 0.08  # relative, of a volume: what the side that nobody sees leaves out
    heap_rest_sd: float = 0.25  # the same of a heap, whose outline is nearly its foot's alone: it hardly shows a height


SINGLE_TUNING = SingleTuning()
