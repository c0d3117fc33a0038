"""Says how much a pip installation report would download, and whether CUDA packages are among it."""

import json
import os
import ssl
import sys
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def size_bytes(url: str, tls: ssl.SSLContext) -> int | None:
    """Size of the file at `url` as its server reports it; 0 for a local file, None if the server does not."""
    if not url.startswith("https://"):
        return 0
    # Only https gets here, which is what S310 asks to make sure of.
    request = urllib.request.Request(url, method="HEAD")  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=15, context=tls) as answer:  # noqa: S310
            length = answer.headers.get("Content-Length")
    except OSError:
        return None
    return int(length) if length else None


def main(report: Path) -> None:
    packages = json.loads(report.read_text())["install"]
    names = [package["metadata"]["name"] for package in packages]
    urls = [package["download_info"]["url"] for package in packages]
    tls = ssl.create_default_context(cafile=os.environ.get("PIP_CERT") or os.environ.get("SSL_CERT_FILE"))
    with ThreadPoolExecutor(8) as pool:
        sizes = list(pool.map(lambda url: size_bytes(url, tls), urls))
    total = sum(size or 0 for size in sizes)
    unknown = sum(size is None for size in sizes)
    cuda = [name for name in names if name.startswith(("nvidia-", "cuda-", "triton"))]
    amount = f"{total / 1e9:.1f} GB" if total >= 1e9 else f"{total / 1e6:.0f} MB"
    rest = f" and {unknown} files of unknown size" if unknown else ""
    print(f"torch and what it needs: {amount} to download{rest}")
    if cuda:
        print(f"among it {len(cuda)} CUDA packages, which this program does not need: {', '.join(cuda[:4])}, ...")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
