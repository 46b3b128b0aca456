"""Names of the files and columns that results have of beams in photos."""

BEAMS_FILE, PICTURES_FILE = "beams.csv", "beam_pictures.csv"
#: Picture, what it shows, why it was chosen, where its edges are on the target, and its size before it was reduced.
PICTURE_COLUMNS = (
    "picture",
    "observation",
    "image",
    "why",
    "left_m",
    "right_m",
    "low_m",
    "high_m",
    "width_px",
    "height_px",
)
