#!/usr/bin/env python3
"""Reads the metrics of a service and judges them by Prometheus' own parser.

Its argument is `host:port` or `unix:/path`, as in the setting metrics.listen. It writes the samples as one JSON object,
{"name{label=value}": number}. It fails on anything that the strict parser of OpenMetrics refuses: names, types, units,
buckets that do not rise or do not end in the count; and on a metric that the parser of the older text format loses.
"""

import http.client
import json
import re
import socket
import sys

from prometheus_client import parser
from prometheus_client.openmetrics import parser as strict

NAME = re.compile(r"facewire_[a-z_]+")


class Connection(http.client.HTTPConnection):
    """To a Unix socket, too."""

    def __init__(self, listen):
        self.path = listen.removeprefix("unix:") if listen.startswith("unix:") else None
        super().__init__("localhost" if self.path else listen, timeout=60)

    def connect(self):
        if self.path is None:
            super().connect()
        else:
            self.sock = socket.socket(socket.AF_UNIX)
            self.sock.settimeout(60)
            self.sock.connect(self.path)


def page(listen):
    """The page, if it is one."""
    connection = Connection(listen)
    connection.request("GET", "/metrics")
    answer = connection.getresponse()
    assert answer.status == 200, answer.status
    kind = answer.headers.get_content_type()
    assert kind == "application/openmetrics-text", kind
    return answer.read().decode()


def samples(families):
    """Every sample under its name and labels."""
    for family in families:
        assert NAME.fullmatch(family.name) and family.documentation, family
        for sample in family.samples:
            labels = ",".join(f"{key}={value}" for key, value in sorted(sample.labels.items()))
            yield f"{sample.name}{{{labels}}}", sample.value


def main():
    text = page(sys.argv[1])
    found = dict(samples(strict.text_string_to_metric_families(text)))
    old = {sample.name for family in parser.text_string_to_metric_families(text) for sample in family.samples}
    lost = {name.split("{")[0] for name in found} - old
    assert not lost, f"the older parser loses {lost}"
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
