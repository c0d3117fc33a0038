#!/opt/caris/bin/python
"""Health check of a container: exit status 0 if the server at URL answers with TEXT in its status line or body.

The token comes from the secret of the container. Certificates are not checked: nothing leaves this computer.
"""

import http.client
import pathlib
import ssl
import sys
import urllib.parse

url, text = sys.argv[1:]
parts = urllib.parse.urlsplit(url)
if parts.hostname != "127.0.0.1":
    sys.exit("only for 127.0.0.1")
token = pathlib.Path("/run/secrets/token")
headers = {"Authorization": f"Bearer {token.read_text().strip()}"} if token.exists() else {}
if parts.scheme == "https":
    context = ssl._create_unverified_context()  # noqa: S323
    connection = http.client.HTTPSConnection(parts.hostname, parts.port, timeout=5, context=context)
else:
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=5)
connection.request("GET", parts.path or "/", headers=headers)
answer = connection.getresponse()
found = f"{answer.status} {answer.read(65_536).decode(errors='replace')}"
sys.exit(None if text in found else found)
