#!/usr/bin/env python3
"""Send events of edgectl by mail, to Slack or to ntfy; for ``on_event`` in an inventory.

The events come as JSON on standard input. Only the standard library is needed.
  notify.py mail ana@lab.example              by the sendmail of this machine
  notify.py slack https://hooks.slack.com/..  an incoming webhook (or: slack @FILE, a file that holds its URL)
  notify.py ntfy https://ntfy.sh/my-lab       a topic of ntfy
"""

import json
import subprocess
import sys
import urllib.request
from email.message import EmailMessage
from pathlib import Path

TIMEOUT_S = 8


def main() -> int:
    """Send the events; the exit code and the last line tell edgectl if that failed."""
    way, target = sys.argv[1:3]
    if target.startswith("@"):
        target = Path(target[1:]).expanduser().read_text().strip()
    events = json.load(sys.stdin)
    lines = [format_event(event) for event in events["items"]]
    if events["omitted"]:
        lines.insert(0, f"({events['omitted']} older events are left out)")
    title, text = f"edgectl {events['fleet']}: {lines[-1]}", "\n".join(lines)
    if way == "mail":
        send_mail(target, title, text)
    elif way == "slack":
        post(
            target, json.dumps({"text": f"*edgectl {events['fleet']}*\n{text}"}).encode(), "application/json"
        )
    elif way == "ntfy":
        post(target, text.encode(), "text/plain; charset=utf-8")
    else:
        sys.stderr.write(f"unknown way {way}: write mail, slack or ntfy\n")
        return 1
    return 0


def format_event(event: dict) -> str:
    """One line for one event."""
    subject = " on ".join(name for name in (event["task"], event["host"]) if name)
    return " ".join(part for part in (event["at"], event["kind"], subject, event["message"]) if part)


def send_mail(to: str, title: str, text: str) -> None:
    """Hand a mail to the sendmail of this machine."""
    message = EmailMessage()
    message["To"], message["Subject"] = to, " ".join(title.split())[:150]
    message.set_content(text)
    subprocess.run(["sendmail", "-t", "-oi"], input=message.as_bytes(), timeout=TIMEOUT_S, check=True)


def post(url: str, data: bytes, kind: str) -> None:
    """Send data by HTTP."""
    if not url.startswith(("https://", "http://")):
        sys.exit(f"{url[:8]}.. is no address of a web server")
    request = urllib.request.Request(url, data=data, headers={"Content-Type": kind})  # noqa: S310 - checked
    with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310
        pass


if __name__ == "__main__":
    sys.exit(main())
