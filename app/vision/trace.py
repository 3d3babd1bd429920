"""The results of a run so far: filled step by step, for figures.py and the record's parameters."""

from dataclasses import dataclass, field

from app.vision.geometry.topview import TableTrend
from app.vision.paper.printed_stereo import PrintedStereo
from app.vision.scene.segmentation import Foods, rim_radii_mm
from app.vision.solids.measured_item import MeasuredItem
from app.vision.views.views_trace import ViewsTrace


@dataclass(slots=True)
class Trace(ViewsTrace):
    """What is found in the views, and the views; None or empty where the run ended before.

    foods: what stands on the table.
    table: how it departs from the marker's plane, where heights count from it (the default method); None: they count
        from that plane.
    items: measured foods.
    printed: the stereo of the method paper-strict.
    """

    foods: Foods | None = None
    table: TableTrend | None = None
    items: list[MeasuredItem] = field(default_factory=list)
    printed: PrintedStereo | None = None

    def parameters(self) -> dict[str, object]:
        """What the record keeps of a run: its views, dishes' rims, and the paper's depth model."""
        out = self.view_parameters()
        out |= {} if self.foods is None else {"rim_radii_mm": rim_radii_mm(self.foods)}
        if self.printed is not None:
            out["printed_depth_p_mm"] = round(self.printed.depth.p_mm, 3)
            out["printed_depth_q_mm_px"] = round(self.printed.depth.q_mm_px, 3)
        return out
