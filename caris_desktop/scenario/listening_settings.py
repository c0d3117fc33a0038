"""Speech recognition section of a scenario."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class ListeningSettings:
    """How what is said near the robot is turned into text, and when somebody has finished. Used with the permission
    `transcription`.
    """

    language: Annotated[
        str,
        FieldSpec(
            "Spoken language, as two or three letters; if empty, the model detects it automatically, if it "
            "knows several.",
            pattern="^([a-z]{2,3})?$",
            allowed="a code such as en, es, fr or de.",
        ),
    ] = "en"
    engine: Annotated[
        Literal["local", "server"],
        FieldSpec("`local`: this computer; `server`: a server that accepts OpenAI transcription requests.", quiet=True),
    ] = "local"
    model: Annotated[
        str,
        FieldSpec(
            "The recogniser: a faster-whisper folder. Give its path, its name next to the scenario or in a "
            "models folder, or the `https://` address of one as a .zip; the default one if empty. With "
            "`server`, the name of its model.",
            longest=1000,
            external="model",
            quiet=True,
        ),
    ] = ""
    sha256: Annotated[
        str,
        FieldSpec(
            "Checksum of the folder's model.bin, or of the .zip; required for an address.",
            title="Checksum (SHA-256)",
            pattern="^([0-9a-fA-F]{64})?$",
            allowed="the 64 digits that sha256sum prints.",
            quiet=True,
        ),
    ] = ""
    server: Annotated[
        str,
        FieldSpec(
            "With `engine: server`: its address. Its key, if required, is CARIS_TRANSCRIPTION_KEY in the "
            "environment, for the server in CARIS_TRANSCRIPTION_SERVER, or CARIS_TRANSCRIPTION_KEY@HOST in "
            "the system's keyring.",
            pattern="^(https?://.+)?$",
            external="address",
            allowed="https://HOST/v1, or http://HOST:PORT/v1 on this computer.",
            longest=300,
            quiet=True,
        ),
    ] = ""
    silence_at_least_s: Annotated[
        float,
        FieldSpec(
            "A turn never ends before this much silence, however certain the console is.",
            title="Shortest silence", unit="seconds", at_least=0.2, at_most=3, quiet=True,
        ),
    ] = 0.3  # fmt: skip
    silence_at_most_s: Annotated[
        float,
        FieldSpec(
            "A turn always ends after this much silence. Between the two limits, the console learns from "
                "each participant's pauses.",
            title="Longest silence", unit="seconds", at_least=0.5, at_most=10, quiet=True,
        ),
    ] = 3.0  # fmt: skip
