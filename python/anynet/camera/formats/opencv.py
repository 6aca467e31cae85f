"""OpenCV's YAML, XML and JSON, by whatever tool and with whatever names; SimpleStereo's JSON too. No unit is told.

Of a rectified pair: Q, or P1 and P2, or K and T. Of raw cameras: K1, D1, K2, D2, R and T of `stereoCalibrate`.
Source: OpenCV's documentation of `stereoCalibrate` and `stereoRectify`.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import (
    EXCHANGED,
    Found,
    Matrix,
    Request,
    camera_values,
    from_projections,
    from_rig,
    from_values,
)
from anynet.camera.formats.models import model_of_text, unknown_model
from anynet.camera.formats.names import Named, Names, matrix, plain
from anynet.camera.rig import FISHEYE, PINHOLE, Camera, StereoRig
from anynet.camera.tree import Tree, numbers, shortened
from anynet.errors import AnyNetError

_Q = ("Q", "disparityToDepth", "disparityToDepthMatrix", "dispToDepth", "disp2depth", "reprojectionMatrix", "matQ",
      "Q_matrix", "stereoQ", "perspectiveTransform")  # fmt: skip
_P = ("P", "projMat", "proj", "projection", "projectionMatrix", "projMatrix", "matP", "P_rect")
_K = ("K", "M", "cameraMatrix", "camMatrix", "camMat", "intrinsicMatrix", "intrinsic", "intrinsics", "cameraIntrinsics",
      "cameraIntrinsic", "mtx", "matK", "camK", "A", "matrix")  # fmt: skip
_D = ("D", "distCoeffs", "distCoeff", "distCoefs", "distCoef", "dist", "distortion", "distortionCoefficients",
      "distortionCoeffs", "distortionVector", "matD", "camD", "kc")  # fmt: skip
_R = ("R", "rotation", "rotationMatrix", "rot", "stereoR", "matR", "R_stereo", "R12", "R_lr", "extrinsicRotation")
_T = ("T", "translation", "translationVector", "translationMatrix", "trans", "stereoT", "matT", "T_stereo", "T12",
      "T_lr", "tvec", "extrinsicTranslation")  # fmt: skip

_MODEL = ("model", "modelType", "cameraModel", "distortionModel", "distortionType")
_LENS = ("cameraType", "lens", "lensModel", "lensType", "projection", "projectionModel", "projectionType", "type")

_OF_A_CAMERA = {plain(name) for name in _P + _K + _D}
_OF_THE_RIG = {plain(name) for name in _Q + _R + _T}


def recognizes(documents: Sequence[Document]) -> bool:
    return all(document.kind in ("yaml", "xml", "json") and document.fields for document in documents)


def read(documents: Sequence[Document], request: Request) -> Found:
    tree = _merged(documents)
    names = Names(tree, _K)
    meters = request.meters or names.meters() or 1.0
    found = Found("OpenCV", size=names.size())
    q = names.one(_Q)
    projections = names.pair(_P)
    if projections is not None:
        left, right = (matrix(named, 3, 4) for named in projections)
        from_projections(found, left, right, meters, f"{projections[1][0]}[0, 3] = -focal * baseline")
        found.origin = f"OpenCV, {projections[0][0]} and {projections[1][0]}"
        if q is not None:
            _compare(found, matrix(q, 4, 4), meters)
    elif q is not None:
        _from_q(found, matrix(q, 4, 4), q[0], meters)
    raw = str(tree.get("images")).lower() == "raw"  # in files of ours
    try:
        _from_cameras(found, names, meters, raw)
    except AnyNetError as error:
        if not found.values or raw:
            raise
        found.warnings.append(f"the raw cameras are left out: {error}")
    if not found.values and found.rig is None:
        raise AnyNetError(
            "the calibration lacks Q, P1 and P2, or K and T (or give --focal and --baseline); "
            f"it has {shortened(', '.join(map(str, tree))) or 'nothing'}"
        )
    return found


def _merged(documents: Sequence[Document]) -> dict[str, Tree]:
    """The fields of all files. OpenCV's sample has intrinsics.yml and extrinsics.yml; others, a file for each camera.

    Raises:
        AnyNetError: if files do not say the same of what there is once.
    """
    tree: dict[str, Tree] = {}
    clashing: dict[str, list[tuple[Document, Tree]]] = {}
    for document in documents:
        for name, node in document.fields.items():
            if tree.setdefault(name, node) != node and plain(name) in _OF_A_CAMERA | _OF_THE_RIG:
                clashing[name] = [(d, d.fields[name]) for d in documents if name in d.fields]
    for name, found in clashing.items():
        files = " and ".join(document.path.name for document, _ in found)
        if plain(name) in _OF_THE_RIG or len(found) > 2:
            raise AnyNetError(f"expected {name} once, got different ones in {files}")
        del tree[name]
        (first, left), (second, right) = found
        if "right" in first.path.name.lower() and "left" in second.path.name.lower():
            left, right = right, left
        for side, node in (("left", left), ("right", right)):
            fields = tree.setdefault(side, {})
            if not isinstance(fields, dict):
                raise AnyNetError(f"expected {name} once, got different ones in {files}")
            fields[name] = node
    return tree


def _from_q(found: Found, q: Matrix, name: str, meters: float) -> None:
    """Z = Q[2, 3] / (Q[3, 2] d + Q[3, 3]), Q[3, 2] = -1 / Tx."""
    if q[3, 2] == 0 or not np.isfinite(q).all():
        raise AnyNetError(f"expected {name}[3, 2] = -1 / Tx, got {q[3, 2]:g}")
    if abs(q[0, 0] - 1) > 1e-6 or abs(q[1, 1] - 1) > 1e-6:
        raise AnyNetError(f"expected {name} of OpenCV's stereoRectify, whose first two diagonal values are 1")
    found.origin = f"OpenCV, {name}"
    doffs = float(q[3, 3] / q[3, 2])
    found.values = {
        "focal": float(q[2, 3]), "baseline": float(abs(1 / q[3, 2]) * meters),
        "cx": float(-q[0, 3]), "cy": float(-q[1, 3]), "doffs": doffs,
    }  # fmt: skip
    if q[3, 2] < 0:
        found.values |= {"cx": found.values["cx"] + doffs, "doffs": -doffs}
        found.warnings.append(EXCHANGED)


def _compare(found: Found, q: Matrix, meters: float) -> None:
    """Warns where Q says something else than the projections."""
    other = Found("")
    _from_q(other, q, "Q", meters)
    differing = []
    for name, value in found.values.items():
        tolerance = 0.01 * value if name in ("focal", "baseline") else 0.5
        if abs(value - other.values[name]) > tolerance:
            differing.append(f"{name} {value:g} against {other.values[name]:g}")
    if differing:
        found.warnings.append(f"P1, P2 and Q do not agree ({', '.join(differing)}): P1 and P2 are used")


def _from_cameras(found: Found, names: Names, meters: float, raw: bool) -> None:
    """Enters the raw cameras, if there are any, or the rectified ones if they have no distortion and no rotation.

    Raises:
        AnyNetError: if they are not usable.
    """
    one = names.one(_K)
    cameras = names.pair(_K) or (None if one is None else (one, one))
    if cameras is None:
        return
    distortions = names.pair(_D) or (names.one(_D),) * 2
    told = _model(names)
    model = told or PINHOLE
    left, right = (
        Camera(_intrinsics(named), np.zeros(0) if other is None else _distortion(other), model)
        for named, other in zip(cameras, distortions, strict=True)
    )
    four = all(np.count_nonzero(camera.distortion) == camera.distortion.size == 4 for camera in (left, right))
    if four and told is None:
        found.warnings.append(
            "4 distortion coefficients are taken as k1, k2, p1, p2 of a pinhole camera; if they are of cv2.fisheye, "
            "add `model: fisheye` to the file"
        )
    rotation, translation = _motion(names)
    if found.values:  # told already; the raw cameras are beside them
        if rotation is not None and translation is not None:
            rig = StereoRig(left, right, rotation, translation * meters, found.size, "OpenCV, raw cameras")
            found.rig = None if rig.is_rectified else rig
            found.raw = raw
        return
    found.origin = "OpenCV, " + " and ".join(dict.fromkeys(name for name, _ in cameras))
    for camera in (left, right):
        camera.check_skew()
    distorted = left.distorted or right.distorted
    turned = rotation is not None and not StereoRig(left, right, rotation, np.array([-1.0, 0.0, 0.0])).is_rectified
    if (translation is None and (distorted or turned)) or (rotation is None and distorted):
        lacking = [name for name, known in (("R", rotation), ("T", translation)) if known is None]
        why = "distortion is not 0" if distorted else "they are turned, or their matrices differ"
        raise AnyNetError(
            f"of unrectified cameras ({why}): the calibration lacks {' and '.join(lacking)}; "
            "give the file that has them as another --calib, or a rectified pair's --focal and --baseline alone"
        )
    if translation is None:
        from_values(found, camera_values(left.matrix, "camera 1"), camera_values(right.matrix, "camera 2"))
        found.lacking["baseline"] = "T"
        return
    turn = np.eye(3) if rotation is None else rotation
    if not translation.any():
        raise AnyNetError("expected T to be the place of the other camera, got 0 0 0")
    from_rig(found, StereoRig(left, right, turn, translation * meters, found.size, found.origin))


def _motion(names: Names) -> tuple[Matrix | None, Matrix | None]:
    """R [3, 3] and T [3] of `stereoCalibrate`; told once, or as each camera's own, to which the world's X is R X + T.

    Raises:
        AnyNetError: if only the left camera's place is told.
    """
    turns, places = names.of_each(_R), names.of_each(_T)
    rotation, translation = names.of_the_rig(_R), names.of_the_rig(_T)
    if turns[0] is None:  # as the left camera sees it, the same as the rig's
        rotation = rotation or turns[1]
    if places[0] is None:
        translation = translation or places[1]
    if None in places and translation is None:
        rotation, translation = rotation or names.of_anything(_R), names.of_anything(_T)
    if translation is not None:
        return None if rotation is None else _rotation(rotation), _vector(translation)
    if places[0] is None:
        return None if rotation is None else _rotation(rotation), None
    if places[1] is None:
        raise AnyNetError(f"expected {places[0][0]} of both cameras, or once of the rig, got the left camera's")
    left, right = (np.eye(3) if named is None else _rotation(named) for named in turns)
    turn = right @ left.T if rotation is None else _rotation(rotation)
    return turn, _vector(places[1]) - turn @ _vector(places[0])


def _model(names: Names) -> str | None:
    """The model of both lenses, if it is named.

    Raises:
        AnyNetError: if it is named, or has parameters, of neither kind.
    """
    parameters = names.all(("xi",))
    if parameters:
        raise unknown_model(f"a lens with {parameters[0][0]}")
    if not {"1", "true", "yes"}.isdisjoint(names.texts("fisheye", "isFisheye")):
        return FISHEYE
    told = {model_of_text(text) for text in names.texts(*_MODEL)} - {None} or {
        model_of_text(text, of_a_lens=True) for text in names.texts(*_LENS)
    }
    return FISHEYE if FISHEYE in told else PINHOLE if PINHOLE in told else None


def _intrinsics(named: Named) -> Matrix:
    values = numbers(named[1], named[0])
    if values.size == 4:
        fx, fy, cx, cy = values
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return matrix(named, 3, 3)


def _distortion(named: Named) -> Matrix:
    return numbers(named[1], named[0])


def _rotation(named: Named) -> Matrix:
    values = numbers(named[1], named[0])
    if values.size == 3 and np.isfinite(values).all():
        return np.asarray(cv2.Rodrigues(values)[0], np.float64)
    return matrix(named, 3, 3)


def _vector(named: Named) -> Matrix:
    return matrix(named, 3, 1)[:, 0]
