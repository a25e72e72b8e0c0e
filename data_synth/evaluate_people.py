"""What capture and tracking make of real people in front of a depth camera: three from a Kinect v2, nine poses of six faces.

    python data_synth/evaluate_people.py [--people kinect2_ir_1 ...] [--pictures FOLDER] [--set stage.name=value ...]

The neutral comes from the first nine frames of each; then every frame is tracked, shown three times over since they are
photographs and no video. All of this happens twice: the first time while little is known of the person, and once more with
what the first time has taught (from the pictures alone: no label is used). Printed for each person and time: the neutral's
roughness, which is the root mean square over the face of its mean curvature beyond that of the nearest head that the
identity modes make, 1/m; the distance of v4 from the depth along the ray, mm, where no hair covers the skin; how many frames
were lost; in how many frames a named expression's own curve is the one that changed most from the neutral of the same pose;
and how well a curve tells the expression from the others (AUC). The people are not part of this project: without them it
says so and ends.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.geometry.mesh import cotangent_laplacian, rigid_alignment, transform_points, vertex_areas, vertex_normals
from adaptiveface.geometry.rendering import picture
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import FaceModel, embedded_face_model
from adaptiveface.neutral.capture import capture_actor
from adaptiveface.neutral.face_quality import head_angles
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline import one_thread
from adaptiveface.sensors import Recording
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import TrackedFrame

PEOPLE = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "people"
NAMES = ("kinect2_ir_1", "kinect2_ir_2", "kinect2_ir_3")
#: The neutral frames; after them come the six faces of each pose, in this order. The third has no name in the source.
NEUTRAL, FACES = 9, ("neutral", "smile", "", "eyes closed", "mouth open", "scream")
#: Which of our curves is a face's own.
OWN = {
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "eyes closed": ("eyeBlinkLeft", "eyeBlinkRight"),
    "mouth open": ("jawOpen",),
    "scream": ("jawOpen",),
}
#: Seen from the front: the head is turned by less than this, degrees.
FRONTAL = 25.0
#: A photograph is shown this often.
SHOWN = 3
#: How often all of them are shown.
TIMES = ("first", "repeat")


def main() -> None:
    """Print one line per person, then all of them together."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--people", nargs="*", default=NAMES)
    parser.add_argument("--pictures", type=Path, help="draw the neutrals there")
    parser.add_argument("--set", nargs="*", default=[], help="parameters, stage.name=value")
    args = parser.parse_args()
    parameters = Parameters().replace(**dict(text.split("=", 1) for text in args.set))
    there = [name for name in args.people if (PEOPLE / name).is_dir()]
    if not there:
        print(f"none of {', '.join(args.people)} is in {PEOPLE}: nothing to evaluate")
        return
    model, everybody = embedded_face_model(), []
    print(f"{'':24}{'rough 1/m':>10}{'v4 mm':>8}{'95 %':>8}{'lost':>6}   own curve largest (frontal, all)   AUC (frontal, all)")
    for name in there:
        with one_thread():
            frames = detected_frames(PEOPLE / name)
            actor = capture_actor(frames[:NEUTRAL], model, parameters)
            skin = capture_actor(frames[:NEUTRAL], model).depth_valid
            tracker = FaceTracker(actor, parameters)
            times = [Person(actor, frames, track(tracker, frames), skin) for _ in TIMES]
        everybody.append(times)
        for time, person in zip(TIMES, times, strict=True):
            print(f"{name:14}{time:10}{roughness(actor.neutral, model):10.2f}{person.figures()}", flush=True)
        if args.pictures:
            draw(actor, args.pictures / name)
    if len(everybody) > 1:
        for time, people in zip(TIMES, zip(*everybody, strict=True), strict=True):
            print(f"{'all':14}{time:20}{Everybody(list(people)).figures()}")


def detected_frames(folder: Path) -> list[RgbdFrame]:
    """Every frame with the features that the detector finds."""
    recording, detector = Recording(folder), FeatureDetector()
    frames = [recording.read(number) for number in range(len(recording))]
    return [dataclasses.replace(frame, features=detector.detect(frame)) for frame in frames]


def roughness(neutral: np.ndarray, model: FaceModel) -> float:
    """Root mean square, weighted by area, of the mean curvature of the face beyond its nearest head of the modes, 1/m."""
    face = model.frontal & model.depth_valid
    nearest = nearest_head(neutral, model, face)
    beyond = mean_curvature(neutral, model.triangles) - mean_curvature(nearest, model.triangles)
    area = vertex_areas(nearest, model.triangles)[face]
    return 1000.0 * float(np.sqrt(np.average(beyond[face] ** 2, weights=area)))


def nearest_head(neutral: np.ndarray, model: FaceModel, face: np.ndarray) -> np.ndarray:
    """(V, 3) the head of the identity modes that lies nearest to ``neutral`` (V, 3) over ``face`` (V,), on the same pose."""
    shape, pose = model.mean, np.eye(4)
    basis = model.identity_modes[:, face].reshape(len(model.identity_modes), -1)
    for _ in range(5):
        pose = rigid_alignment(neutral[face], shape[face])
        wanted = (transform_points(pose, neutral[face]) - model.mean[face]).ravel()
        identity = np.linalg.solve(basis @ basis.T + np.eye(len(basis)), basis @ wanted)
        shape = model.neutral(identity)
    return transform_points(np.linalg.inv(pose), shape)


def mean_curvature(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(V,) signed mean curvature, 1/mm, from the cotangent Laplacian (Meyer et al. 2003)."""
    bent = cotangent_laplacian(vertices, triangles) @ vertices
    along: np.ndarray = (bent * vertex_normals(vertices, triangles)).sum(axis=1)
    return along / (2.0 * np.maximum(vertex_areas(vertices, triangles), 1e-9))


def track(tracker: FaceTracker, frames: list[RgbdFrame]) -> list[TrackedFrame]:
    """The last of several looks at every frame."""
    out = []
    for frame in frames:
        for _ in range(SHOWN):
            tracked = tracker.track(frame)
        out.append(tracked)
    return out


class Person:
    """What was tracked of one person: ``curves`` (F, 52) less those of the pose's neutral, ``face`` (F,), ``frontal`` (F,)."""

    def __init__(self, actor: Actor, frames: list[RgbdFrame], tracked: list[TrackedFrame], skin: np.ndarray) -> None:
        x = np.array([result.coefficients for result in tracked])
        self.names, self.gaps = actor.expression_names, _gaps(actor, frames, tracked, skin)
        self.lost = sum(not result.tracked for result in tracked)
        poses = range(NEUTRAL, len(frames), len(FACES))
        rest = {number: first for first in poses for number in range(first, first + len(FACES))}
        seen = [k for k in rest if tracked[k].tracked and tracked[rest[k]].tracked]
        self.change = np.array([x[k] - x[rest[k]] for k in seen])
        self.level = x[seen]
        self.face = [FACES[(k - NEUTRAL) % len(FACES)] for k in seen]
        self.frontal = np.array([np.hypot(*head_angles(tracked[rest[k]].head_pose)) < FRONTAL for k in seen])

    def figures(self) -> str:
        """Of this person alone."""
        return Everybody([self]).figures()


class Everybody:
    """Several people's frames together."""

    def __init__(self, people: list[Person]) -> None:
        self.gaps = np.concatenate([person.gaps for person in people])
        self.change = np.concatenate([person.change for person in people])
        self.level = np.concatenate([person.level for person in people])
        self.face = np.concatenate([person.face for person in people])
        self.frontal = np.concatenate([person.frontal for person in people])
        self.names, self.lost = people[0].names, sum(person.lost for person in people)

    def figures(self) -> str:
        """Distances, shares and AUCs in a row."""
        largest = "  ".join(f"{face} {self.largest(face)}" for face in OWN)
        told = "  ".join(f"{face} {self.told(face, self.frontal):.2f} {self.told(face):.2f}" for face in OWN)
        total = " of ".join(map(str, np.sum([self.counts(face)[0] for face in OWN], axis=0)))
        middle, most = np.percentile(self.gaps, [50, 95])
        return f"{middle:8.2f}{most:8.2f}{self.lost:6d}   {largest}  frontal together {total}   {told}"

    def counts(self, face: str) -> tuple[tuple[int, int], tuple[int, int]]:
        """In how many frames of how many the face's own curve changed most: of the frontal ones, of all."""
        rows = np.flatnonzero(self.face == face)
        change = np.abs(self.change[rows])
        own = [self.names.index(name) for name in OWN[face]]
        hits = change[:, own].max(axis=1) >= change.max(axis=1)
        front = self.frontal[rows]
        return (int(hits[front].sum()), int(front.sum())), (int(hits.sum()), len(rows))

    def largest(self, face: str) -> str:
        """:meth:`counts` as text."""
        return ", ".join(f"{hits}/{count}" for hits, count in self.counts(face))

    def told(self, face: str, some: np.ndarray | None = None) -> float:
        """Area under the receiver's curve of the face's own curve, mean of both sides, against the other faces."""
        columns = [self.names.index(name) for name in OWN[face]]
        some = np.ones(len(self.face), bool) if some is None else some
        mine = {"mouth open", "scream"} if columns == [self.names.index("jawOpen")] else {face}
        is_mine = np.isin(self.face, list(mine))
        score = self.score(columns)
        yes, no = score[some & (self.face == face)], score[some & ~is_mine]
        return float(np.mean((yes[:, None] > no) + 0.5 * (yes[:, None] == no))) if len(yes) and len(no) else float("nan")

    def score(self, columns: list[int]) -> np.ndarray:
        """(F,) mean of some expressions' coefficients."""
        return self.level[:, columns].mean(axis=1)


def _gaps(actor: Actor, frames: list[RgbdFrame], tracked: list[TrackedFrame], skin: np.ndarray) -> np.ndarray:
    """Distances of v4 from the depth along the ray, mm: vertices of the face's ``skin`` (V,) that see the camera."""
    out, face = [], actor.frontal & skin
    for frame, result in zip(frames, tracked, strict=True):
        if result.tracked:
            vertices = result.in_camera(result.v4)
            normals = vertex_normals(vertices, actor.triangles)
            facing = face & ((vertices * normals).sum(axis=1) < -0.5 * np.linalg.norm(vertices, axis=1))
            points = vertices[facing]
            u, v = np.rint(frame.camera.project(points)).astype(int).T
            inside = (u >= 0) & (v >= 0) & (u < frame.camera.width) & (v < frame.camera.height)
            depth = frame.depth[v[inside], u[inside]]
            gap = np.abs(depth - points[inside, 2])
            out.append(gap[(depth > 0) & (gap < 20)])
    return np.concatenate(out)


def draw(actor: Actor, path: Path) -> None:
    """The neutral from the front and from the side, as ``path``.png."""
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    camera, views = Camera(420, 520, 1100.0, 1100.0, 210.0, 260.0), []
    centre = actor.neutral[actor.frontal].mean(axis=0)
    for angle in (0.0, 45.0, 90.0):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        turn = np.diag([1.0, -1.0, -1.0]) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        views.append(picture(camera, (actor.neutral - centre) @ turn.T + [0, 0, 550], actor.triangles))
    cv2.imwrite(f"{path}.png", np.concatenate(views, axis=1)[..., ::-1])


if __name__ == "__main__":
    main()
