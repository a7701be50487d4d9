"""Images: pictures on walls as landmarks, rendered or of the visual lab's folders, and the camera's calibration."""

from data.wing import Recording, Wing, World

RENDERED = "wings.camera.opening:open_rendered"
VISUAL = World("wings.camera.gallery", "Gallery", "visual:0", counts=("frames",), opens=RENDERED)
LAB = Recording(
    "wings.camera.lab.folder:is_lab", "wings.camera.opening:open_lab_log", "lab", "a recording of the visual lab"
)

wing = Wing(
    "camera",
    commands={
        "detect": ("wings.camera.detect:main", "find reference pictures in a photo"),
        "camera": ("wings.camera.command:main", "estimate a camera's calibration from a recording with images"),
    },
    worlds={"visual": VISUAL}, recordings=(LAB,), conversions=("wings.camera.convert",), templates="wings.camera",
    images=("wings.camera.opening:images_of",), sections=("wings.camera.report:visual_sections",),
)  # fmt: skip
