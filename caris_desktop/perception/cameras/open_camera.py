"""Factory of camera sources by kind, with late imports, as most runs use one kind."""

from caris_desktop.domain.plugins import find, load
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSource, ChosenCamera


def open_camera(chosen: ChosenCamera) -> CameraSource:
    """Open a camera; may take some seconds. Raises CameraError."""
    if chosen.kind == "plugin":
        from caris_desktop.perception.cameras.plugin_camera import PluginCamera

        return PluginCamera(chosen)
    if chosen.kind == "robot":
        raise CameraError(
            localized(QT_TR_NOOP("Cameras of the kind {kind} cannot be opened here."), kind=chosen.kind),
            QT_TR_NOOP("Choose it in the console, with --camera."),
        )
    camera: CameraSource = load(find("cameras", chosen.kind))(chosen)
    return camera


def open_http(chosen: ChosenCamera) -> CameraSource:
    """Open an HTTP camera, of whatever it sends. Raises CameraError."""
    from caris_desktop.perception.cameras.http_camera import HttpCamera, NotMultipartError

    try:
        return HttpCamera(chosen)
    except NotMultipartError:
        # A video over HTTP, or another authentication.
        from caris_desktop.perception.cameras.stream_camera import StreamCamera

        return StreamCamera(chosen)
