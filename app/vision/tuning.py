"""The numbers by which points are followed and forms fitted. Those of forms are stored with each run."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FormTuning:
    """Tuning of form_fit.py and shape.py, in the order in which a fit meets it; px are those of the working grid."""

    outline_sd_px: float = 0.7  # sd of an outline
    # around an outline: beyond it the distance from the field's border is added
    field_margin_px: int = 32
    # side of the square over which the distance is averaged: an outline's points jitter
    smooth_px: int = 3
    smooth_weight_px: int = 9  # the same of the weights, which begin and end
    samples: tuple[float, ...] = (0.125, 0.375, 0.625, 0.875)  # along a segment of a form's outline
    outline_run_px: float = 10.0  # length along an outline over which its errors are one
    dense_sd_px: float = 0.5  # sd of the dense parallax
    dense_area_px: float = 100.0  # area over which errors of the dense parallax are one
    least_sd_px: float = 1e-3  # of parallax
    averaged_px: int = 5  # side of the square over which any parallax is averaged
    # sd of the mean that a food's detail is told from; chosen on development scenes
    detail_px: float = 14.0
    averaged_along_px: int = 21  # the same of one measured along a form, about that form's
    roughness_mm: float = 1.0  # sd of a food's surface about its form: skin, crumb, leaves; the dense parallax's in mm
    roughness_run_mm: float = 5.0  # length over which it is one
    # sd of parallax along a surface beside its noise: interpolation, gloss, poses
    surface_sd_px: float = 0.12
    max_sd_px: float = 1.0  # sd of parallax beyond which a point is left out
    # of an observation that a form leaves unexplained: between a good one's and a bad one's
    unexplained_loss: float = 2.0
    loss_scale: float = 2.5  # sds beyond which a misfit counts less and less (Cauchy)
    # Cosines of the slant between which a point begins to show its parallax, in the first view and in the second.
    facing: tuple[float, float] = (0.1, 0.3)
    facing_second: tuple[float, float] = (0.075, 0.225)
    contact_mm: float = 0.25  # height over its lowest point within which a form touches its support
    foot_mm: float = 1.0  # height over the support up to which a point is partly the foot's
    min_outline: int = 8  # points of an outline below which it takes no part
    damping: tuple[float, float, float] = (0.1, 1e-4, 1e4)  # Marquardt's: start, least, most
    damping_rise: float = 8.0  # after a step that does not lower the cost
    damping_fall: float = 4.0  # after one that does
    widest: float = 8.0  # tolerance that a fit begins with at most; it is halved in each round
    # fall of the cost that ends a coarse fit, which only ranks families
    settled_coarse: float = 1.0
    settled_fine: float = 0.05  # the same of a fine fit
    most_rounds: int = 40  # of any fit
    coverage_weight: float = 0.5  # of a point of the food's outline against one of the form's
    # from the form's outline, beyond which a point of the food's is not explained
    unexplained_px: float = 4.0
    first_rounds: int = 6  # of the coarse fit of a family, before the nearest are chosen
    top_quantile: float = 0.98  # of the points' heights: strays lie above it
    margin_px: int = 25  # around a food's mask
    # forms nearest after these, which are fitted coarsely to the end; a family may begin twice
    kept_coarse: int = 5
    kept: int = 3  # families that are fitted finely
    # of a family in the average: below it, a family is fitted no further
    least_weight: float = 1e-4
    max_passes: int = 2  # fine fits along the best form, at most
    # relative change of the best volume in a pass below which no further one is needed
    settled: float = 0.03
    snap_px: float = 4.0  # across an outline, how far its edge is sought in the first view
    snap_second_px: float = 5.0  # the same in the second view
    second_weight: float = 0.5  # of the second view's outline, which was sought where the form was
    # How clear an outline is in the second view over how clear in the first: no food of 252 at rest,
    # of two rendered sets, lies below; pushed foods and parts of a dish had 0.05 to 0.48.
    least_seen_again: float = 0.5
    # the same of what colours alone show; prints on a table had 0.6: chosen on development scenes
    sure_seen_again: float = 0.65
    # height over its support of what colours alone show; a telephone has 8 to 9 mm
    least_height_mm: float = 13.0
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

    # of an outline: irregularities of a fiftieth of a food that spans 100 px
    outline_sd_px: float = 2.0
    kept: int = 9  # families that are fitted finely: one outline tells few of them apart
    rest_sd: float = 0.08  # relative, of a volume: what the side that nobody sees leaves out
    food_height_sd: float = (
        0.2  # of the logarithm of height over width, of pieces of one food: ECUSTFD's specimens
    )
    heap_rest_sd: float = 0.25  # the same of a heap, whose outline is nearly its foot's alone: it hardly shows a height
    # the same of any food seen from the side as well: how it is cut out there, and from how high it was taken;
    # by the share of 28 specimens of ECUSTFD (half of them, by a seed) that the 90 % interval holds
    side_rest_sd: float = 0.2


SINGLE_TUNING = SingleTuning()


@dataclass(frozen=True, slots=True)
class SideTuning:
    """Tuning of a photograph from the side (food_again.py, side_view.py), in the order in which it is met."""

    piece_px: int = 128  # of the longer side of a piece's box while it is cut out
    grown: float = 0.05  # of a box's sides, on each side: what may be food
    margin: float = 0.25  # of the same: what surely is not
    cut_rounds: int = 3
    most_of_box: float = 0.98  # of what may be food: more of it, and nothing was cut out
    # Log odds that a piece is the food: by the cosine of their features, by the logarithm of its share of the
    # photograph, by its share of its own box, as shadows and the table between things have less, and for none. Fitted
    # to 314 pieces of 70 photographs of ECUSTFD (Liang and Li, 2017), one of which is the food or none is: where one is
    # likelier than none (86 %), it is the food in 90 %, by specimens left out.
    cosine_odds: float = 20.1
    size_odds: float = 1.9
    fullness_odds: float = 20.9
    no_odds: float = -21.4
    largest_share: float = 0.2  # of the photograph: no food is likelier for being larger
    # Radians over the table: such photographs are taken at about the height of the food, ECUSTFD's plates are seen at 5
    # to 17 degrees.
    elevation: float = 0.19
    # of a pose: azimuth, elevation, roll, logarithm of the distance, place px; what is not known of them is wide
    pose_sd: tuple[float, ...] = (1.5, 0.05, 0.05, 1.0, 100.0, 100.0)
    pose_stride: tuple[float, ...] = (0.15, 0.08, 0.05, 0.15, 5.0, 5.0)  # the most at one step
    # tried, over half a turn: a silhouette from behind is nearly the mirror image
    azimuths: int = 12
    raising_rounds: int = 3  # in which a form is made as high as its mask
    height_sd: float = 0.7  # of a height, logarithm, before it is seen


SIDE_TUNING = SideTuning()


@dataclass(frozen=True, slots=True)
class FlowTuning:
    """Tuning of point_following.py, in the order in which it is met; px are those of pictures of some 1,600 px."""

    noise_blur_px: float = 0.8  # phones' noise is finer than what their lenses resolve
    even_px: int = 31  # side of the square over which light is made even
    level: float = 128.0  # mean of an evenly lit picture, grey levels
    contrast: float = 40.0  # its standard deviation
    noise_levels: float = 2.0  # grey levels: what plain surfaces have, and should not be stretched
    corners: int = 500  # at most
    corner_quality: float = 0.02  # of the best corner's texture
    corners_apart_px: float = 10.0
    corner_px: int = 7  # side of the square whose texture counts
    window_px: int = 25  # side of what is followed; of 15, one in ten would be a wrong one
    levels: int = 3  # above the picture, each of half the size: foods move against their table
    most_rounds: int = 20
    least_step_px: float = 0.01  # a smaller one ends it
    least_texture: float = 1e-3  # of a window, as OpenCV counts it
    most_unlike: float = 22.0  # mean difference of two windows, grey levels: a correlation of 0.7
    # Of 9,600 corners of 41 training scenes within half a pixel of the truth 70 % come back so near;
    # of those that come back, one in twenty is wrong, before windows are compared and epipolar lines asked.
    most_return_px: float = 0.15


FLOW_TUNING = FlowTuning()


@dataclass(frozen=True, slots=True)
class ColourTuning:
    """Tuning of what colours show (segmentation.py, by_colour.py, min_cut.py); px of the scene's grid."""

    # at least, by which a course of light is fitted, if there are so many
    course_points: int = 4000
    settled: float = 0.005  # share of a cut's pixels that change, below which it is the last one
    # What stands beside a shadow colours half of them. Standard deviation along chroma, bins of colour_bins.py; and by
    # how much a shadow that leaves no light may be off, units of CIELAB bytes. Chosen on half of ECUSTFD's specimens
    # (Liang and Li, 2017) and on rendered scenes, whose shadows have little of it.
    cast_bins: float = 3.0
    cast: float = 12.0
    # share of a thing that is surely no shadow, from which on the rest may be one; chosen on the same photographs
    sure_share: float = 0.4
    unmeasured_px: int = 9  # wide: what a food hides from the second view is narrower
    around_px: int = 21  # side of the square in which the edge of what stands is measured as high
    # Of the heights there: telephones, cutlery, napkins are lower; chosen on development scenes.
    top_quantile: float = 0.95
    low_mm: float = 10.0
    # share of a thing on dishes that heights show, from which on it is one of them; chosen on development scenes
    most_on_dishes: float = 0.25
    # over the table, of a plate or board; higher things are sandwiches and packs: chosen on development scenes
    plain_rim_mm: tuple[float, float] = (4.0, 30.0)


COLOUR_TUNING = ColourTuning()


@dataclass(frozen=True, slots=True)
class FloorTuning:
    """Tuning of plane_sweep.py and floors.py, in the order in which it is met; px of the scene's grid.

    Where no other source is given: chosen on 25 boards and 104 plates of rendered scenes.
    """

    # standard deviations: finer is noise, coarser are light and what a glaze mirrors
    detail_px: tuple[float, float] = (0.7, 4.0)
    # of a pixel's surroundings within the area: beside its border a shadow's slope passes for grain
    inner_share: float = 0.85
    grain_sds: float = 2.0  # of the detail, beyond which it is an edge of food or of a pattern
    px_per_fact: float = 12.0  # neighbours share their noise: 4 pi of the finer detail, twice
    most_correlation: float = 0.99  # of one picture with itself, whose logarithm would be infinite
    most_facts: float = 200.0  # what is no plane correlates by a tenth, however many pixels show it
    least_px: int = 50  # of an area that shows a plane
    # inward from the outline, where food seldom lies and a plate is no longer its rim
    ring_mm: tuple[float, float] = (15.0, 55.0)
    standing_mm: float = 5.0  # over the rim: food
    clear_px: int = 21  # side of the square around food that its heights spread over
    # height of a board's top over its rim as heights show it, whose windows see the table as well, and its sd
    board_over_rim_mm: tuple[float, float] = (1.5, 2.0)
    # a plate's floor as a share of its rim's height, and its sd: anywhere in the lower half
    plate_of_rim: tuple[float, float] = (0.3, 0.17)
    step_mm: float = 1.0
    # Log odds from which on it is a board: of 25 boards and 104 plates that rims showed, one board lay below and no
    # plate above.
    least_odds: float = 1.2


FLOOR_TUNING = FloorTuning()
