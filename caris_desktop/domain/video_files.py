"""Safe opening of foreign video files: no references to other files."""

FILM_OPTIONS = {
    # A playlist, which looks like a film to ffmpeg, names other files and addresses.
    "protocol_whitelist": "file",
    "format_whitelist": (
        "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,ogg,h264,hevc,m4v,mjpeg,ivf,mxf,gif"
    ),
}
"""Options of ``av.open`` for reading."""
