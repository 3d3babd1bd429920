"""JSON of requests and answers, from the OpenAPI document by tools/client_types.py; /docs describes it."""

from typing import Any, Literal, NotRequired, TypedDict


AfterHintIn = TypedDict(
    "AfterHintIn",
    {
        "point": NotRequired[list[float] | None],
        "box": NotRequired[list[float] | None],
        "polygon": NotRequired[list[list[float]] | list[list[list[float]]] | None],
        "food": NotRequired[str | None],
        "lies_as": NotRequired[
            Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"] | None
        ],
        "form": NotRequired[
            Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"] | None
        ],
        "vessel": NotRequired[str | None],
        "item": NotRequired[str | None],
        "class": NotRequired[Literal["food_left", "refuse"] | None],
    },
)


class AfterMetadataIn(TypedDict):
    captured_at: str
    time_zone: NotRequired[str | None]
    hints: NotRequired[list["AfterHintIn"]]
    complete: NotRequired[bool]
    camera: NotRequired["CameraIn | None"]
    poses: NotRequired["PosesIn | None"]


class AfterOut(TypedDict):
    status: (
        Literal[
            "receiving",
            "queued",
            "processing",
            "estimated",
            "needs_review",
            "failed",
            "nothing_left",
        ]
        | None
    )
    due_at: str | None
    captured_at: str | None
    ignored: list[str]
    images: dict[str, "ImageOut"]
    missing: list[str]
    failure: "FailureOut | None"
    leftovers: list["LeftoverOut"]
    artefacts: list["ArtefactOut"]


class AmountIn(TypedDict):
    mass_g: NotRequired[float | None]
    of: NotRequired[Literal["as_seen", "edible"] | None]
    volume_ml: NotRequired[float | None]
    portion: NotRequired[str | None]
    count: NotRequired[float | None]
    relative_sd: NotRequired[float | None]


class ArtefactOut(TypedDict):
    name: str
    media_type: str
    bytes: int
    href: str


class CameraIn(TypedDict):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: NotRequired[list[float]]


class CandidateOut(TypedDict):
    food: "FoodRef"
    probability: float | None
    source: Literal["hint", "index", "model"]
    reasons: list[str]


class ChangePage(TypedDict):
    records: list["RecordOfItem"]
    days: list["ChangedDayOut"]
    erased: list["ErasedOut"]
    next: str
    has_more: bool


class ChangedDayOut(TypedDict):
    id: str
    participant: str
    local_date: str
    status: Literal["open", "closed"]
    ate_nothing: bool
    change_seq: int


class CheckMetadataIn(TypedDict):
    marker: NotRequired[str | None]
    camera: NotRequired["CameraIn | None"]
    locale: NotRequired[Literal["en", "de", "es", "zh"] | None]


class CheckOut(TypedDict):
    ok: bool
    problems: list["CheckProblemOut"]
    measures: dict[str, float]
    locale: Literal["en", "de", "es", "zh"]
    seconds: float


class CheckProblemOut(TypedDict):
    code: str
    severity: Literal["stop", "warn"]
    side: Literal["left", "right"] | None
    message: str


class ComparedOut(TypedDict):
    mean: float
    interval: list[float]
    days: int
    coverage: float
    reference: float
    kind: Literal["rda", "ai", "cdrr"]
    verdict: Literal[
        "reaches", "below", "above_limit", "under_limit", "open", "open_adequate", "open_coverage"
    ]


class ComparisonOut(TypedDict):
    window_days: int
    closed_days: int
    whole_days: int
    why_not: Literal["days_needed", "profile_needed"] | None
    components: dict[str, "ComparedOut"]


class DayIn(TypedDict):
    status: Literal["open", "closed"]
    ate_nothing: NotRequired[bool]


class DayOut(TypedDict):
    date: str
    study_day: int | None
    status: Literal["open", "closed"]
    ate_nothing: bool
    decided_by: Literal["participant", "reviewer"] | None
    meals: int
    meals_after_closing: int
    version: int
    changed_at: str | None


class DeclaredItemIn(TypedDict):
    food: str
    amount: NotRequired["AmountIn | None"]
    share: NotRequired[float]
    copied: NotRequired[bool]


class DeclaredMealIn(TypedDict):
    id: str
    captured_at: str
    time_zone: str
    items: list["DeclaredItemIn"]
    location: NotRequired["LocationIn | None"]
    app_version: NotRequired[str | None]


class DensityChoiceOut(TypedDict):
    chosen: "DensityOut"
    reason: str
    alternatives: list["RejectedDensityOut"]


class DensityOut(TypedDict):
    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: Literal["solid", "bulk"]
    basis: Literal["study", "measured", "fao", "portion", "related", "composition", "group"]
    source: str
    weighs: Literal["as_seen", "edible"]


class DepthCameraIn(TypedDict):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    unit_mm: NotRequired[float]


class DoubleReview(TypedDict):
    seed: int
    share: float
    strata: NotRequired[list["ReviewStratum"]]
    limit_percent: float
    known_share: NotRequired[float]


class EatenAmountOut(TypedDict):
    amount: float | None
    interval: list[float] | None
    coverage: float | None


class EatenMealOut(TypedDict):
    meal_id: str
    captured_at: str
    items: int
    unmeasured_items: int
    components: dict[str, "EatenAmountOut"]


class EnrolmentCodeOut(TypedDict):
    code: str
    expires_at: str
    qr_text: str
    qr_svg: str
    capture_url: str


class EnrolmentIn(TypedDict):
    code: str
    device_name: str
    model: NotRequired[str | None]
    app_version: NotRequired[str | None]
    secret: NotRequired[str | None]


class EnrolmentOut(TypedDict):
    token: str
    device_id: str
    study: str
    participant: str
    marker: str | None


class ErasedOut(TypedDict):
    kind: Literal["record", "day"]
    id_sha256: str
    change_seq: int


ExportFiltersIn = TypedDict(
    "ExportFiltersIn",
    {
        "participant": NotRequired[str | None],
        "from": NotRequired[str | None],
        "to": NotRequired[str | None],
        "food": NotRequired[list[str]],
        "status": NotRequired[
            list[
                Literal[
                    "proposed",
                    "needs_review",
                    "confirmed",
                    "corrected",
                    "rejected",
                    "receiving",
                    "queued",
                    "processing",
                    "estimated",
                    "failed",
                ]
            ]
        ],
        "flag": NotRequired[list[str]],
        "origin": NotRequired[Literal["photographed", "declared"] | None],
        "needs": NotRequired[Literal["review", "answer"] | None],
        "failure": NotRequired[list[str]],
        "after_status": NotRequired[
            list[
                Literal[
                    "receiving",
                    "queued",
                    "processing",
                    "estimated",
                    "needs_review",
                    "failed",
                    "nothing_left",
                ]
            ]
        ],
    },
)


class ExportIn(TypedDict):
    rows: Literal["items", "meals", "days", "photographs", "participants"]
    layout: NotRequired[Literal["wide", "long"]]
    format: NotRequired[Literal["csv", "ndjson", "parquet", "geojson"]]
    components: NotRequired[Literal["headline", "all"]]
    provenance: NotRequired[bool]
    filters: NotRequired["ExportFiltersIn"]


class ExportOut(TypedDict):
    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled", "expired"]
    rows: Literal["items", "meals", "days", "photographs", "participants"]
    layout: Literal["wide", "long"]
    format: Literal["csv", "ndjson", "parquet", "geojson"]
    components: Literal["headline", "all"]
    provenance: bool
    filters: dict[str, Any]
    asked_by: str
    requested_at: str
    started_at: str | None
    finished_at: str | None
    rows_written: int
    rows_estimated: int | None
    bytes: int
    sha256: str | None
    change_seq: int | None
    failure: str | None
    file: str | None
    expires_at: str | None


class FailureOut(TypedDict):
    code: str
    message: str
    advice: str
    localised: dict[str, str]


class FoodMatch(TypedDict):
    key: str
    name: str
    aliases: list[str]
    group: str
    form: Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"]
    state: Literal["raw", "cooked", "as_eaten"] | None
    is_mixed_dish: bool
    release: str
    matched: str | None


class FoodOut(TypedDict):
    key: str
    name: str
    aliases: list[str]
    group: str
    form: Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"]
    version: int
    state: Literal["raw", "cooked", "as_eaten"] | None
    is_mixed_dish: bool
    refuse: list["RefuseOut"]
    edible_share: float
    probes: list[str]
    source_ids: dict[str, str]
    release: str
    densities: list["DensityOut"]
    density: "DensityChoiceOut | None"
    nutrients: list["NutrientOut"]
    portions: list["PortionOut"]
    recipe: "RecipeOut | None"


class FoodRef(TypedDict):
    key: str
    name: str


class HintIn(TypedDict):
    point: NotRequired[list[float] | None]
    box: NotRequired[list[float] | None]
    polygon: NotRequired[list[list[float]] | list[list[list[float]]] | None]
    food: NotRequired[str | None]
    lies_as: NotRequired[Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"] | None]
    form: NotRequired[Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"] | None]
    vessel: NotRequired[str | None]


class ImageOut(TypedDict):
    received_sha256: str
    bytes: int
    media_type: str
    width_px: int
    height_px: int
    flags: list[str]
    received_at: str
    durable: NotRequired[Literal[True]]


class IngredientOut(TypedDict):
    key: str
    name: str
    version: int
    state: Literal["raw", "cooked", "as_eaten"] | None
    mass_g: float
    retention: dict[str, float]
    retention_source: str | None
    is_current: bool


class ItemOut(TypedDict):
    id: str
    status: Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
    origin: Literal["pipeline", "after", "declared", "added", "split", "merged"]
    polygon: list[list[list[float]]]
    food: "FoodRef | None"
    lies_as: Literal["whole", "lying", "slab", "heap", "liquid", "in_vessel"] | None
    candidates: list["CandidateOut"]
    none_of_these: float | None
    index_version: str | None
    volume_ml: float | None
    volume_interval_ml: list[float] | None
    density_g_per_ml: float | None
    density_sd_g_per_ml: float | None
    density_basis: (
        Literal["study", "measured", "fao", "portion", "related", "composition", "group"] | None
    )
    density_source: str | None
    mass_g: float | None
    mass_interval_g: list[float] | None
    edible_share: float | None
    edible_g: float | None
    share: float
    left_g: float | None
    consumed_g: float | None
    consumed_interval_g: list[float] | None
    provisional: bool
    reviewed: bool
    parent: str | None
    open_probes: list[str]
    nutrients: list["NutrientAmount"]
    flags: list[str]


LeftoverOut = TypedDict(
    "LeftoverOut",
    {
        "id": str,
        "class": Literal["food_left", "refuse", "unmatched"],
        "item": str | None,
        "is_by_person": bool,
        "polygon": list[list[list[float]]],
        "food": "FoodRef | None",
        "volume_ml": float | None,
        "volume_interval_ml": list[float] | None,
        "mass_g": float | None,
        "mass_interval_g": list[float] | None,
        "flags": list[str],
    },
)


class LocationIn(TypedDict):
    latitude: float
    longitude: float
    accuracy_m: NotRequired[float | None]


class MeOut(TypedDict):
    participant: str
    starts_on: str | None
    joined_at: str
    study: "PhoneProtocol"
    device: "PhoneOut"


class MealLinks(TypedDict):
    meal: str
    photograph_left: str | None


class MealListItem(TypedDict):
    id: str
    study: str
    participant: str
    status: Literal[
        "receiving", "queued", "processing", "estimated", "needs_review", "failed", "confirmed"
    ]
    stage: str | None
    failure_code: str | None
    captured_at: str
    time_zone: str
    local_date: str
    received_at: str
    upload_delay_seconds: float
    origin: Literal["photographed", "declared"]
    after_status: (
        Literal[
            "receiving",
            "queued",
            "processing",
            "estimated",
            "needs_review",
            "failed",
            "nothing_left",
        ]
        | None
    )
    provisional: bool
    version: int
    item_count: int
    foods: list["FoodRef"]
    consumed_g: float | None
    energy_kcal: float | None
    unmeasured_items: int
    items_without_energy: int
    doubt: float | None
    flags: list[str]
    links: "MealLinks"


class MealMetadataIn(TypedDict):
    captured_at: str
    time_zone: str
    marker: NotRequired[str | None]
    camera: NotRequired["CameraIn | None"]
    rig: NotRequired["RigIn | None"]
    poses: NotRequired["PosesIn | None"]
    hints: NotRequired[list["HintIn"]]
    complete: NotRequired[bool]
    views: NotRequired[int]
    depth_camera: NotRequired["DepthCameraIn | None"]
    depth_maps: NotRequired[
        list[Literal["left_depth", "right_depth", "left_confidence", "right_confidence"]] | None
    ]
    location: NotRequired["LocationIn | None"]
    app_version: NotRequired[str | None]


class MealOut(TypedDict):
    id: str
    study: str
    participant: str
    status: Literal[
        "receiving", "queued", "processing", "estimated", "needs_review", "failed", "confirmed"
    ]
    stage: str | None
    captured_at: str
    time_zone: str
    local_date: str
    received_at: str
    version: int
    flags: list[str]
    ignored: list[str]
    images: dict[str, "ImageOut"]
    missing: list[str]
    voice_note: NotRequired["VoiceNoteOut | None"]
    failure: "FailureOut | None"
    after: "AfterOut | None"
    items: list["ItemOut"]
    totals: "TotalsOut"
    run: "RunOut | None"


class NutrientAmount(TypedDict):
    number: str
    tagname: str | None
    name: str
    unit: str
    amount: float
    interval: list[float] | None


class NutrientOut(TypedDict):
    number: str
    tagname: str | None
    name: str
    unit: str
    expression: str | None
    per_100_g: float


class NutrientTotal(TypedDict):
    number: str
    tagname: str | None
    name: str
    unit: str
    amount: float
    interval: list[float] | None
    coverage: float | None


class PairPosesIn(TypedDict):
    left: list[list[float]]
    right: list[list[float]]


class ParticipantIn(TypedDict):
    starts_on: NotRequired[str | None]
    arm: NotRequired[str | None]
    visit: NotRequired[str | None]
    excluded: NotRequired[str | None]
    code: str
    profile: NotRequired["ProfileIn"]


class ParticipantOut(TypedDict):
    code: str
    starts_on: str | None
    arm: str | None
    visit: str | None
    excluded: str | None
    withdrawn_at: str | None
    created_at: str
    profile: "ProfileIn"


class PhoneOut(TypedDict):
    id: str
    name: str
    model: str | None
    app_version: str | None
    clock_skew_seconds: float | None
    last_used_at: str | None
    enrolled_at: str
    revoked_at: str | None


class PhoneProtocol(TypedDict):
    code: str
    name: str
    marker: str | None
    expects_after_pair: bool
    after_window_minutes: int
    locale: Literal["en", "de", "es", "zh"]
    gives_feedback: bool
    location_policy: Literal["drop", "round", "keep"]
    retention_days: int | None
    withdrawal_policy: Literal["keep", "anonymise", "erase"]
    day_starts: str
    sandbox: bool
    version: int


class PhoneVesselOut(TypedDict):
    kind: Literal["mug", "cup", "glass", "tall_glass", "bowl", "soup_bowl", "deep_plate", "other"]
    rim_diameter_mm: float
    height_mm: float
    capacity_ml: NotRequired[float | None]
    fill_line_mm: NotRequired[float | None]
    fill_line_ml: NotRequired[float | None]
    inside_profile_mm: NotRequired[list[list[float]]]
    name: str
    version: int


class PhotographOut(TypedDict):
    meal_id: str
    study: str
    participant: str
    captured_at: str
    local_date: str
    slot: Literal[
        "left",
        "right",
        "view3",
        "view4",
        "view5",
        "view6",
        "view7",
        "view8",
        "after_left",
        "after_right",
        "left_depth",
        "right_depth",
        "left_confidence",
        "right_confidence",
        "voice_note",
    ]
    media_type: str
    width_px: int
    height_px: int
    bytes: int
    received_sha256: str
    stored_sha256: str
    received_at: str
    erased: bool
    erased_at: str | None
    path: str | None


class PortionOut(TypedDict):
    amount: float
    measure: str
    mass_g: float


class PosesIn(TypedDict):
    convention: Literal["arkit", "arcore", "opencv"]
    views: "PairPosesIn"
    gravity: NotRequired[list[float] | None]


class ProfileIn(TypedDict):
    sex: NotRequired[Literal["female", "male"] | None]
    birth_year: NotRequired[int | None]
    height_cm: NotRequired[float | None]
    weight_kg: NotRequired[float | None]
    activity: NotRequired[Literal["sedentary", "low_active", "active", "very_active"] | None]
    is_pregnant: NotRequired[bool | None]
    trimester: NotRequired[Literal[1, 2, 3] | None]
    is_lactating: NotRequired[bool | None]
    lactation_months: NotRequired[int | None]


class PushKeys(TypedDict):
    p256dh: str
    auth: str


class QuestionOut(TypedDict):
    id: str
    meal: str
    item: str | None
    text: str
    asked_at: str
    captured_at: str
    local_date: str
    etag: str


class ReceiptOut(TypedDict):
    id: str
    what: Literal["participant", "meal", "photographs"]
    policy: Literal["keep", "anonymise", "erase", "retention"]
    counts: dict[str, int]
    erased_at: str


class RecipeOut(TypedDict):
    yield_factor: float
    ingredients: list["IngredientOut"]
    unknown: list["UnknownComponentOut"]


class RecordOfItem(TypedDict):
    id: str
    meal_id: str
    study: str
    participant: str
    captured_at: str
    time_zone: str
    local_date: str
    upload_delay_seconds: float
    status: Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
    origin: Literal["pipeline", "after", "declared", "added", "split", "merged"]
    provisional: bool
    reviewed: bool
    food: "FoodRef | None"
    food_table: str | None
    volume_ml: float | None
    volume_low_ml: float | None
    volume_high_ml: float | None
    density_g_per_ml: float | None
    density_source: str | None
    mass_g: float | None
    mass_low_g: float | None
    mass_high_g: float | None
    edible_g: float | None
    share: float
    left_g: float | None
    consumed_g: float | None
    consumed_low_g: float | None
    consumed_high_g: float | None
    energy_kcal: float | None
    protein_g: float | None
    fat_g: float | None
    carbohydrate_g: float | None
    fibre_g: float | None
    sugar_g: float | None
    saturated_fat_g: float | None
    sodium_mg: float | None
    potassium_mg: float | None
    vitamin_c_mg: float | None
    nutrient_intervals: dict[str, list[float] | None]
    flags: list[str]
    change_seq: int


class RecordOut(TypedDict):
    id: str
    meal_id: str
    study: str
    participant: str
    captured_at: str
    time_zone: str
    local_date: str
    upload_delay_seconds: float
    status: Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
    origin: Literal["pipeline", "after", "declared", "added", "split", "merged"]
    provisional: bool
    reviewed: bool
    food: "FoodRef | None"
    food_table: str | None
    volume_ml: float | None
    volume_low_ml: float | None
    volume_high_ml: float | None
    density_g_per_ml: float | None
    density_source: str | None
    mass_g: float | None
    mass_low_g: float | None
    mass_high_g: float | None
    edible_g: float | None
    share: float
    left_g: float | None
    consumed_g: float | None
    consumed_low_g: float | None
    consumed_high_g: float | None
    energy_kcal: float | None
    protein_g: float | None
    fat_g: float | None
    carbohydrate_g: float | None
    fibre_g: float | None
    sugar_g: float | None
    saturated_fat_g: float | None
    sodium_mg: float | None
    potassium_mg: float | None
    vitamin_c_mg: float | None
    nutrient_intervals: dict[str, list[float] | None]
    flags: list[str]
    change_seq: int
    day_status: Literal["open", "closed"]
    study_day: int | None


class RefuseOut(TypedDict):
    part: str
    percent: float
    is_served: bool


class RejectedDensityOut(TypedDict):
    g_per_ml: float
    sd_g_per_ml: float
    state: str
    kind: Literal["solid", "bulk"]
    basis: Literal["study", "measured", "fao", "portion", "related", "composition", "group"]
    source: str
    weighs: Literal["as_seen", "edible"]
    reason: str


class RemindersIn(TypedDict):
    subscription: "SubscriptionIn"
    times: NotRequired[list[str] | None]
    after_meal: NotRequired[bool]
    time_zone: str
    quiet_from: NotRequired[str]
    quiet_until: NotRequired[str]


class RemindersOut(TypedDict):
    available: bool
    public_key: str | None
    study_times: list[str]
    subscribed: bool
    times: list[str] | None
    after_meal: bool | None
    time_zone: str | None
    quiet_from: str | None
    quiet_until: str | None


class ReviewStratum(TypedDict):
    food_group: NotRequired[str | None]
    min_doubt: NotRequired[float]
    share: float


class RigIn(TypedDict):
    left: "CameraIn"
    right: "CameraIn"
    R: list[list[float]]
    t_mm: list[float]
    rms_px: NotRequired[float | None]
    pairs: NotRequired[int | None]


class RunOut(TypedDict):
    id: str
    method: str
    pipeline_version: str
    marker: str | None
    camera: dict[str, Any] | None
    parameters: dict[str, Any]
    stages: dict[str, float]
    seconds: float
    food_tables: list[str]
    created_at: str
    artefacts: list["ArtefactOut"]


class ServerLimitsOut(TypedDict):
    photo_bytes: int
    photo_pixels: int
    metadata_bytes: int
    hints: int
    wait_seconds: int


class ServerOut(TypedDict):
    version: str
    api_versions: list[str]
    time: str
    image_types: list[str]
    metadata_fields: list[str]
    hint_fields: list[str]
    features: list[str]
    limits: "ServerLimitsOut"


class StudyIn(TypedDict):
    marker: NotRequired[str | None]
    camera: NotRequired["CameraIn | None"]
    expects_after_pair: NotRequired[bool]
    after_window_minutes: NotRequired[int]
    location_policy: NotRequired[Literal["drop", "round", "keep"]]
    location_decimals: NotRequired[int | None]
    retention_days: NotRequired[int | None]
    withdrawal_policy: NotRequired[Literal["keep", "anonymise", "erase"]]
    locale: NotRequired[Literal["en", "de", "es", "zh"]]
    gives_feedback: NotRequired[bool]
    day_starts: NotRequired[str]
    shares_index: NotRequired[bool]
    identifies_by_context: NotRequired[bool]
    web_origins: NotRequired[list[str]]
    reminder_times: NotRequired[list[str]]
    double_review: NotRequired["DoubleReview | None"]
    code: str
    name: str
    sandbox: NotRequired[bool]


class StudyOut(TypedDict):
    code: str
    name: str
    marker: str | None
    camera: "CameraIn | None"
    expects_after_pair: bool
    after_window_minutes: int
    location_policy: Literal["drop", "round", "keep"]
    location_decimals: int | None
    retention_days: int | None
    withdrawal_policy: Literal["keep", "anonymise", "erase"]
    locale: Literal["en", "de", "es", "zh"]
    gives_feedback: bool
    day_starts: str
    shares_index: bool
    identifies_by_context: bool
    web_origins: list[str]
    reminder_times: list[str]
    double_review: "DoubleReview | None"
    sandbox: bool
    version: int
    created_at: str


class SubscriptionIn(TypedDict):
    endpoint: str
    keys: "PushKeys"


class SummaryOut(TypedDict):
    date: str
    study_day: int | None
    status: Literal["open", "closed"]
    ate_nothing: bool
    meals: list["EatenMealOut"]
    components: dict[str, "EatenAmountOut"]
    unmeasured_meals: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    comparison: "ComparisonOut"
    locale: Literal["en", "de", "es", "zh"]
    sentences: list[str]
    disclaimer: str


class TotalsOut(TypedDict):
    consumed_g: float | None
    consumed_interval_g: list[float] | None
    unmeasured_items: int
    nutrients: list["NutrientTotal"]


class UnknownComponentOut(TypedDict):
    number: str
    tagname: str | None
    name: str
    unit: str
    coverage: float


class VoiceNoteOut(TypedDict):
    received_sha256: str
    bytes: int
    media_type: str
    received_at: str
    durable: NotRequired[Literal[True]]
