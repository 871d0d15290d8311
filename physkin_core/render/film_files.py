"""Files that hold moving pictures: .mp4 (PyAV), .gif and .webp (Pillow), and numbered .png. Extra `[view]`.

Dimensions: `h`, `w` height and width of a picture [pixels]. A picture is (h, w, 3) uint8 sRGB.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from physkin_core.output_file import check_folder
from physkin_core.pictures.picture import pillow, save_png

__all__ = ["FILM_KINDS", "check_film", "write_film"]

FASTEST_GIF = 50.0  # [Hz] viewers slow down what is faster
CONSTANT_QUALITY = "18"  # of H.264: 0 is exact, 23 usual
WEBP_QUALITY = 80


def check_film(path: Path, *, size: tuple[int, int], rate_hz: float) -> None:
    """Whether a film can be written so, before anything is drawn. size: w, h.

    Raises ValueError naming what is allowed, ModuleNotFoundError or PictureError where the extra is not installed.
    """
    kind = path.suffix.lower()
    if kind not in FILM_KINDS:
        raise ValueError(f"cannot write {path.name}: allowed are {', '.join(FILM_KINDS)}")
    check_folder(path)
    if kind == ".mp4":
        import av  # noqa: F401 (missing is told now, not after minutes of drawing)

        if size[0] % 2 or size[1] % 2:
            raise ValueError(f"an .mp4 needs an even width and height, got {size[0]}x{size[1]}")
    if kind == ".gif" and rate_hz > FASTEST_GIF:
        raise ValueError(f"a .gif shows at most {FASTEST_GIF:g} frames a second, got {rate_hz:g}; give --rate 25")


def write_film(path: Path, pictures: Iterable[np.ndarray], rate_hz: float) -> list[Path]:
    """Write pictures as they come. path: `x.png` becomes `x_0000.png` and so on. Returns the files.

    Films that people loop (.gif, .webp) start again at their end.
    """
    return FILM_KINDS[path.suffix.lower()](path, pictures, rate_hz)


def _write_mp4(path: Path, pictures: Iterable[np.ndarray], rate_hz: float) -> list[Path]:
    import av

    with av.open(str(path), "w", options={"movflags": "faststart"}) as file:
        stream = None
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            if stream is None:
                stream = file.add_stream("libx264", rate=Fraction(rate_hz).limit_denominator(1000))
                stream.width, stream.height, stream.pix_fmt = frame.width, frame.height, "yuv420p"
                stream.options = {"crf": CONSTANT_QUALITY}
            file.mux(stream.encode(frame))
        if stream is not None:
            file.mux(stream.encode())
    return [path]


def _write_animation(path: Path, pictures: Iterable[np.ndarray], rate_hz: float, *, tick: int, **options) -> list[Path]:
    """tick: [ms] what the format can tell apart; durations add up to the rate."""
    first, *others = [pillow().Image.fromarray(picture) for picture in pictures]
    stamps = np.round(1000 / tick / rate_hz * np.arange(len(others) + 2)).astype(int)
    durations = (tick * np.diff(stamps)).tolist()
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, **options)
    return [path]


def _write_numbered(path: Path, pictures: Iterable[np.ndarray], rate_hz: float) -> list[Path]:
    files = []
    for number, picture in enumerate(pictures):
        files.append(path.with_name(f"{path.stem}_{number:04d}{path.suffix}"))
        save_png(files[-1], picture)
    return files


FILM_KINDS: dict[str, Callable[[Path, Iterable[np.ndarray], float], list[Path]]] = {
    ".mp4": _write_mp4,
    ".gif": partial(_write_animation, tick=10, optimize=True),
    ".webp": partial(_write_animation, tick=1, quality=WEBP_QUALITY, method=6, minimize_size=True),
    ".png": _write_numbered,
}
"""Ending of a film's name -> what writes it."""
