"""What becomes of JPEGs of a stream that lack one byte, and of whole ones, before real scenes. Prints both tables.

PYTHONPATH=tests python tests/benchmarks/missing_bytes.py --pictures 2000
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from stadimeter.cameras.mjpeg_stream import JpegStream
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.errors import PictureError
from stadimeter.perception.perceiver import Perceiver
from stadimeter.simulation.silhouette import paint_ball

REAL_PICTURES = Path(__file__).resolve().parents[3] / "shared" / "data"
LENS = CameraModel(width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5)
SCENES = 60


def scenes(width_px: int) -> list[Image]:
    """Return real pictures of a width."""
    paths = sorted(path for path in REAL_PICTURES.rglob("*") if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
    random.Random(1).shuffle(paths)  # noqa: S311 - the same pictures each time
    pictures = (cv2.imread(str(path)) for path in paths[:SCENES])
    return [
        cv2.resize(
            picture, (width_px, round(width_px * picture.shape[0] / picture.shape[1])), interpolation=cv2.INTER_AREA
        )
        for picture in pictures
        if picture is not None
    ]


def with_a_ball(scene: Image, rng: random.Random) -> bytes:
    """Return a JPEG of a ball of 20 cm before a scene, with noise, at a quality of 50 to 95."""
    picture = cv2.resize(scene, (LENS.width_px, LENS.height_px), interpolation=cv2.INTER_AREA)
    distance_m = rng.uniform(1, 4)
    paint_ball(
        picture, LENS, (rng.uniform(-0.25, 0.25) * distance_m, rng.uniform(-0.2, 0.2) * distance_m, distance_m), 0.1
    )
    noise = np.random.default_rng(rng.getrandbits(32)).normal(0, 2, picture.shape)
    noisy = np.clip(picture + noise, 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, rng.randint(50, 95)])[1].tobytes()


def measured(image: Image) -> Measurement:
    """Measure the ball."""
    ball = BallDetector("ball", BallOptions.model_validate({"diameter": "20 cm", "hsv": "29,86,6:64,255,255"}))
    return Perceiver({"ball": ball}, LENS).look(Frame(image, 0.0, 0), {})[1][0]


def outcome(data: bytes, rng: random.Random) -> str:
    """Return what becomes of a picture that lacks one byte, behind the whole one."""
    scan = data.rindex(b"\xff\xda")
    at = rng.randrange(scan + 2 + int.from_bytes(data[scan + 2 : scan + 4], "big"), len(data) - 2)
    stream = JpegStream()
    whole = decoded(stream, data) or decoded(stream, data)
    damaged = decoded(stream, data[:at] + data[at + 1 :])
    if whole is None or damaged is None:
        return "refused"
    truth, found = measured(whole[0]), measured(damaged[0])
    if found.distance_m is None:
        return "ball not measured"
    if truth.distance_m is None or abs(found.distance_m - truth.distance_m) > truth.sigma_m:
        return "beyond one standard deviation of the whole picture"
    return "within one standard deviation of the whole picture"


def decoded(stream: JpegStream, data: bytes) -> tuple[Image] | None:
    """Return a picture, or None if it is refused."""
    try:
        return (stream.decode(data),)
    except PictureError:
        return None


def turning(picture: Image, rng: random.Random) -> Iterator[bytes]:
    """Yield what a camera sees that turns before a scene: 10 pictures, up to 25 px apart."""
    height_px, width_px = LENS.height_px, LENS.width_px
    step_x, step_y = rng.randint(-25, 25), rng.randint(-10, 10)
    x, y = rng.randint(0, picture.shape[1] - width_px), rng.randint(0, picture.shape[0] - height_px)
    quality = [cv2.IMWRITE_JPEG_QUALITY, rng.randint(50, 95)]
    for _ in range(10):
        x = min(max(0, x + step_x), picture.shape[1] - width_px)
        y = min(max(0, y + step_y), picture.shape[0] - height_px)
        yield cv2.imencode(".jpg", picture[y : y + height_px, x : x + width_px], quality)[1].tobytes()


def cost(data: bytes, rounds: int = 300) -> float:
    """Return the time of a picture in `JpegStream` as a multiple of decoding it, by turns; the median."""
    stream, image, ratios = JpegStream(), np.empty((LENS.height_px, LENS.width_px, 3), np.uint8), []
    for _ in range(rounds):
        began_s = time.perf_counter()
        simplejpeg.decode_jpeg(data, "BGR", buffer=image)
        between_s = time.perf_counter()
        decoded(stream, data)
        ratios.append((time.perf_counter() - between_s) / (between_s - began_s))
    return float(np.median(ratios))


def main() -> None:
    """Print what becomes of damaged pictures and of whole ones, and what the look costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=2000)
    pictures = parser.parse_args().pictures
    small, large = scenes(LENS.width_px), scenes(1200)
    outcomes: Counter[str] = Counter()
    for number in range(pictures):
        rng = random.Random(number)  # noqa: S311 - the same picture each time
        outcomes[outcome(with_a_ball(small[number % len(small)], rng), rng)] += 1
    print(outcomes.most_common())
    whole: Counter[bool] = Counter()
    for number in range(pictures // 4):
        rng, stream = random.Random(number), JpegStream()  # noqa: S311
        scene = large[number % len(large)]
        if scene.shape[0] > LENS.height_px:
            whole.update(decoded(stream, data) is not None for data in turning(scene, rng))
    print(f"whole pictures of a camera that turns: {whole[False]} of {whole.total()} refused")
    print(f"time: {cost(with_a_ball(small[0], random.Random(0))):.2f} of decoding alone")  # noqa: S311


if __name__ == "__main__":
    main()
