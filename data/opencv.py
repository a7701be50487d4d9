"""OpenCV, which only images and films need: `from data.opencv import cv2`, with one line where it is missing."""

from data.errors import UsageError

try:
    import cv2 as cv2
except ImportError:
    raise UsageError("images and films need OpenCV: pip install 'slamref[images]'") from None
