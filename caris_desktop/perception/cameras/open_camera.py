"""Factory of camera sources by kind, with late imports, as most runs use one kind."""

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSource
from caris_desktop.perception.cameras.chosen_camera import ChosenCamera


def open_camera(chosen: ChosenCamera) -> CameraSource:
    """Open a camera; may take some seconds. Raises CameraError."""
    match chosen.kind:
        case "file" | "stream":
            from caris_desktop.perception.cameras.stream_camera import StreamCamera

            return StreamCamera(chosen)
        case "device":
            from caris_desktop.perception.cameras.device_camera import DeviceCamera

            return DeviceCamera(chosen.target)
        case "oak":
            from caris_desktop.perception.cameras.oak_camera import OakCamera

            return OakCamera(chosen.target)
        case "http":
            return _open_http(chosen)
        case "whep" | "webrtc":
            from caris_desktop.perception.cameras.webrtc_camera import WebRtcCamera

            return WebRtcCamera(chosen)
        case "robot" | "simulated":
            raise CameraError(
                localized(QT_TR_NOOP("Cameras of the kind {kind} cannot be opened here."), kind=chosen.kind),
                QT_TR_NOOP("Choose it in the console, with --camera."),
            )


def _open_http(chosen: ChosenCamera) -> CameraSource:
    from caris_desktop.perception.cameras.http_camera import HttpCamera, NotMultipartError

    try:
        return HttpCamera(chosen)
    except NotMultipartError:
        # A video over HTTP, or another authentication.
        from caris_desktop.perception.cameras.stream_camera import StreamCamera

        return StreamCamera(chosen)
