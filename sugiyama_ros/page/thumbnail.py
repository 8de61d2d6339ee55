"""A small picture of a recording: speeds over time and place."""

from base64 import b64encode
from io import BytesIO

import numpy as np
from bokeh.palettes import Cividis256
from PIL import Image

from sugiyama_ros.page.panels.measured import fastest, frame_mps, places, speeds
from sugiyama_ros.page.recording import Recording

_WIDTH, _HEIGHT = 150, 50


def thumbnail(r: Recording) -> str:
    """The picture as an address for HTML; time runs to the right, the road upward, fast is yellow."""
    place, speed = places(r), speeds(r)
    time = np.broadcast_to(r.time_s[:, None], place.shape)
    place = place - frame_mps(r) * time
    known = np.isfinite(place) & np.isfinite(speed)
    bins = (_WIDTH, _HEIGHT)
    count, *edges = np.histogram2d(time[known], place[known], bins=bins)
    total = np.histogram2d(time[known], place[known], bins=edges, weights=speed[known])[0]
    share = np.clip(total / np.maximum(count, 1) / fastest(r), 0.0, 1.0)
    colours = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in Cividis256], dtype=np.uint8)
    pixels = np.zeros((*bins, 4), dtype=np.uint8)
    pixels[..., :3] = colours[(share * 255).astype(int)]
    pixels[..., 3] = np.where(count > 0, 255, 40)
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])).save(stream, "PNG")
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode()
