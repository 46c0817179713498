"""The public example records: real plants, measured on hardware, fetched once and checked.

`path` looks in the folder TRUEPLANT_DATA_DIR if that is set. Else the record is fetched from the public repository it
was published in, at a pinned commit, brought to the common layout (t, sp, pv, op, ...) and checked: what is handed out
has the sha256 below, whatever the repository holds. Records that were published in another format than text are only
to be had from a folder.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote

from trueplant.errors import SourceError, UsageError

VARIABLE = "TRUEPLANT_DATA_DIR"
HOST = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class Source:
    """A public repository at one commit."""

    repository: str
    commit: str
    licence: str


TCLAB_PID = Source("TiagoPrata/TCLabSP", "e8dfcb02fb74fcc8b5b3b7d4655f93f35bd81820", "MIT")
TCLAB_LQG = Source("rawlings-group/mlid_2024", "9f1c939c2efb81bc57c7459404fc04dfcf36b910", "MIT")
PID_OVEN = Source("cellularmitosis/logs", "31b3970801d84b75c0664bf5dbeff9a2cd1634a1", "MIT")
REFINERY = Source("TerenceXue-tech/StictionGPT", "b592dc8fe7106e5605d3b6fe36d04683d5d50412", "Apache-2.0")


@dataclass(frozen=True)
class Dataset:
    """One record: where it was published, and what it looks like here."""

    source: Source
    sha256: str
    upstream: str | None = None
    """Path in the repository; None if it was not published as text."""
    convert: Callable[[str], str] | None = None


def _oven(period: float) -> Callable[[str], str]:
    """Rows of set-point, PV, OP (and ambient temperature) without a time: one every ``period`` seconds."""

    def convert(text: str) -> str:
        rows = [line.split(",") for line in text.splitlines() if line[:1].isdigit()]
        lines = [",".join(["t", "sp", "pv", "op", "ambient"][: 1 + len(rows[0])])] if rows else []
        for k, row in enumerate(rows):
            lines.append(",".join(f"{value:.4f}" for value in (k * period, *map(float, row))))
        return "\n".join(lines) + "\n"

    return convert


def _refinery(text: str) -> str:
    """Tab-separated history below a head of five lines: time, OP, PV, set-point, mode, flags; one row every 10 s."""
    rows = [line.split("\t") for line in text.splitlines() if line.count("\t") >= 8 and line[:2] == "20"]
    lines = ["t,time,op,pv,sp,mode"]
    for k, (time, op, pv, sp, mode, *_) in enumerate(rows):
        lines.append(f"{10.0 * k},{time},{float(op)!r},{float(pv)!r},{float(sp)!r},{mode}")
    return "\n".join(lines) + "\n"


_OVEN_0114 = {
    "run16-p7.0-i0.5-d1.0-250ms": "e376f9264db1dc10dc1078153cc8bcf791818605208bc9f6f972fca129699112",
    "run18-p7.0-i0.5-d0.5-250ms": "f8cdb5c07550b18ce69a6a0f27fd1c13c2ff862c1f591a3d6d5203097c38b731",
    "run5-p3.0-i0.0-d0.0-250ms": "1320795832931fdbbce002bf246ca1f49a1b496dbd69ed535bd48d5684ea7387",
}
_OVEN_0205 = {
    "run2": "45bf8165d15c0e3c646177e0b9de4d4e4a9747a44dea0be985a2d86abfd8c984",
    "run3": "3675d92c48d5759b14ea127662c630c4a62a7b20ffcc7c1c3c4c3d16c12fe5e0",
    "run4": "415803e74c5bdbf80aaa8f7343ce3c8ac90d027957e3f0eac6ace9ba21bf651c",
    "run5": "f7842da0c3e32addae16719c91eae6a511c598083c6a2f198ec438a3238b80e0",
    "run6": "580ea4240e91ef1c88ac3c79312cfb92aba9e64aeeb9bdc07c47490b11bc6490",
    "run7": "28f8c74ec3b452a911f70ad42c7e8fc64119e6dad062d83249f8fde5123b18f2",
    "run8": "e508c189756b2a6ca713024af1e522d0350bd563b354258cc45e207c1a0c3798",
}
_PLANT = "plant_data/non-stiction_data/stic_2111"

REGISTRY: dict[str, Dataset] = {
    "tclab_pid/pid_short_01.csv": Dataset(
        TCLAB_PID, "dfa1275e3758868211a9487ac4cd9eece95527c537d3113bdfef7f74a6e90bb8"
    ),
    "tclab_pid/pid_short_02.csv": Dataset(
        TCLAB_PID, "ab963355324d507715a6316b9abe813cd53e1729061d93ac1ea7f62ed38270be"
    ),
    "tclab_pid/openloop_01.csv": Dataset(TCLAB_PID, "f59eeda4ad600ad5563f8415d44de1e853aa85e75bad3de049a5570af56dd0b4"),
    "tclab_lqg/sp_Augmented_ARX.csv": Dataset(
        TCLAB_LQG, "c8d9def2a1e3037fef92d322b9b671b062d72cc3ed877455796460432ecd0470"
    ),
    "tclab_lqg/sp_Regularized_ML_1.csv": Dataset(
        TCLAB_LQG, "c772903cc9b16af593e48a758d5fc81f6840f0ff1518e0bf148208eeade78277"
    ),
    "tclab_lqg/openloop_prbs.csv": Dataset(
        TCLAB_LQG, "283cfa4a8afad89b6c9213b826370b5c53a627319d1ad4b026737e21b21aec49"
    ),
    "refinery/FIC10201_1018.csv": Dataset(
        REFINERY,
        "505c3378d29ea257e3f6c6b79a7abaaaf1053a600b96a1078713d1eb1a6ead2a",
        f"{_PLANT}FIC10201_1018_0002_Stick1=0.55571.txt",
        _refinery,
    ),
    "refinery/FIC45102C_1117.csv": Dataset(
        REFINERY,
        "b799ce96e4def12dea05825e56ebcaf16776aafa09e2f19b70d434f6c32efe62",
        f"{_PLANT}FIC45102C_1117_0003_Stick1=0.txt",
        _refinery,
    ),
    **{
        f"pid_oven/20180114-pid-oven-tuning_{run}.csv": Dataset(
            PID_OVEN, digest, f"20180114-pid-oven-tuning/{run}.csv", _oven(0.25)
        )
        for run, digest in _OVEN_0114.items()
    },
    **{
        f"pid_oven/20180205-pid-oven-tuning_{run}.csv": Dataset(
            PID_OVEN, digest, f"20180205-pid-oven-tuning/{run}/tune.csv", _oven(1.0)
        )
        for run, digest in _OVEN_0205.items()
    },
}


def path(name: str) -> Path:
    """Where the record ``name``, such as "refinery/FIC10201_1018.csv", lies on this machine.

    Raises UsageError for a name that is not in `REGISTRY`, and SourceError if the record is not in the folder
    TRUEPLANT_DATA_DIR, cannot be fetched, or is not what it was when its checksum was taken.
    """
    if name not in REGISTRY:
        raise UsageError(f"there is no example record {name!r}: the names are {', '.join(sorted(REGISTRY))}")
    folder = os.environ.get(VARIABLE)
    if folder:
        file = Path(folder) / name
        if not file.is_file():
            raise SourceError(f"{name} is not in the folder {folder} that {VARIABLE} names: put it there, or unset it")
        if _digest(file.read_bytes()) != REGISTRY[name].sha256:
            raise SourceError(
                f"{name} in the folder {folder} that {VARIABLE} names is not the record that was published: fetch it "
                "again, or give it in the project as a file of your own"
            )
        return file
    dataset = REGISTRY[name]
    if dataset.upstream is None or dataset.convert is None:
        raise SourceError(
            f"{name} was published in {dataset.source.repository} on GitHub in a MATLAB or Python format: put it as "
            f"text into a folder, as {name}, and set {VARIABLE} to that folder"
        )
    import pooch

    file = Path(pooch.os_cache("trueplant")) / name
    if not (file.is_file() and _digest(file.read_bytes()) == dataset.sha256):
        _fetch(dataset, file)
    return file


def _digest(content: bytes) -> str:
    return sha256(content).hexdigest()


def _fetch(dataset: Dataset, file: Path) -> None:
    """Download, convert, check, and only then put in place."""
    import tempfile

    import pooch

    source = dataset.source
    url = f"{HOST}/{source.repository}/{source.commit}/{quote(dataset.upstream or '')}"
    advice = f"try again later, or put the record into a folder and set {VARIABLE} to that folder"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=file.parent) as folder:
            raw = Path(folder) / "raw"
            pooch.HTTPDownloader(timeout=30)(url, str(raw), None)
            content = dataset.convert(raw.read_text("utf-8")).encode() if dataset.convert else raw.read_bytes()
            if _digest(content) != dataset.sha256:
                raise SourceError(f"{url} does not hold the record that was published as {file.name}: {advice}")
            checked = Path(folder) / "checked"
            checked.write_bytes(content)
            checked.replace(file)
    except (OSError, ValueError) as error:
        # what requests raises is an OSError too
        reason = str(error).splitlines()[0][:200]
        raise SourceError(f"{url} cannot be had ({type(error).__name__}: {reason}): {advice}") from error
