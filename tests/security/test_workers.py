"""Who has no certificate reaches neither scheduler nor workers: he would run code as the owner."""

import os
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import ExitStack

import dask
import distributed
import psutil
import pytest

from palpate.app.commands.lab import distribution
from palpate.campaign import check_workers, engine as engine_file, started_engine
from palpate.errors import InputError


@pytest.fixture(scope="module")
def workers():
    """A cluster of this machine's own."""
    with started_engine(None, 1) as engine:
        yield engine


# In a process of his own, as any user of this machine may start it.
STRANGER = """
import os, sys, dask, distributed
address, certificate = sys.argv[1:]
own = {}
if certificate == "his own":
    own["security"] = distributed.Security.temporary()
elif os.path.exists(certificate):
    own["security"] = distributed.Security(
        tls_ca_file=certificate, tls_client_cert=certificate, require_encryption=True
    )
try:
    client = distributed.Client(address, timeout=5, **own)
    print("ran in", client.run_on_scheduler(os.getpid), flush=True)
finally:
    # Without waiting for what is half open.
    os._exit(0)
"""


def _reached(address, certificate):
    """What a client says that it has run on the scheduler."""
    words = [sys.executable, "-P", "-W", "ignore", "-c", STRANGER, address, certificate]
    return subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=120, check=True).stdout


@pytest.mark.parametrize("certificate", ["none", "his own"])
def test_a_stranger_runs_no_code_on_the_scheduler(workers, certificate):
    address = workers.client.scheduler.address
    assert address.startswith("tls://127.0.0.1:")
    assert _reached(address, certificate) == ""
    assert _reached(address.replace("tls", "tcp"), certificate) == ""


def test_the_owner_does(workers, tmp_path):
    """Or the stranger might fail for another reason."""
    security = workers.client.security
    (tmp_path / "both.pem").write_text(security.tls_client_cert + security.tls_client_key)
    address = workers.client.scheduler.address
    assert _reached(address, str(tmp_path / "both.pem")) == f"ran in {os.getpid()}\n"


def test_nor_on_a_worker_or_what_looks_after_it(workers):
    info = workers.client.scheduler_info()["workers"]
    assert info
    for address, worker in info.items():
        assert address.startswith("tls://127.0.0.1:")
        assert worker["nanny"].startswith("tls://127.0.0.1:")


def test_web_servers_of_dask_have_no_pages(workers):
    """They tell of sessions, of paths and of the machine, and relay to other ports. What is left is
    a list of pages, which has none but itself."""
    (worker,) = workers.client.run(os.getpid).values()
    listening = [
        connection.laddr
        for pid in (os.getpid(), worker)
        for connection in psutil.Process(pid).net_connections("tcp")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert {address.ip for address in listening} <= {"127.0.0.1", "::1"}
    ports = {worker_info["services"]["dashboard"] for worker_info in
             workers.client.scheduler_info()["workers"].values()}  # fmt: skip
    ports.add(workers.client.scheduler_info()["services"]["dashboard"])
    assert ports <= {address.port for address in listening}
    for port in ports:
        for page in (
            "", "status", "info/main/workers.html", "json/counts.json", "metrics", "health",
            "info/logs.html",
        ):  # fmt: skip
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=5)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/sitemap.json", timeout=5) as answer:
            assert answer.read() == b'{"paths": ["/sitemap.json"]}'


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:9", "127.0.0.1:9", "ws://127.0.0.1:9", "TLS://a"]
)
@pytest.mark.parametrize("refusing", [check_workers, started_engine, distribution])
def test_a_scheduler_without_tls_needs_a_flag(address, refusing):
    said = "has no TLS: anybody who reaches it can run code as you; .* or add --insecure"
    with ExitStack() as stack, pytest.raises(InputError, match=said):
        stack.enter_context(refusing(address, None))


def test_the_flag_is_for_a_scheduler_only(monkeypatch):
    with pytest.raises(InputError, match="--insecure without --scheduler"):
        check_workers(None, 2, insecure=True)
    check_workers("tcp://127.0.0.1:9", None, insecure=True)
    check_workers("tls://127.0.0.1:9", None)


def test_a_scheduler_without_tls_is_reached_with_the_flag():
    with (
        distributed.LocalCluster(
            n_workers=1, processes=False, protocol="tcp", dashboard_address=":0"
        ) as cluster,
        started_engine(cluster.scheduler_address, None, insecure=True) as engine,
    ):
        assert list(engine.map(abs, [-1])) == [1]


def test_tls_without_certificates_says_where_they_are_named(monkeypatch):
    monkeypatch.setattr(engine_file, "_CONNECT_TIMEOUT", 1)
    named = ("ca-file", "client.cert", "client.key")
    with (
        dask.config.set({f"distributed.comm.tls.{name}": None for name in named}),
        pytest.raises(InputError, match=r"no certificate is named.*at distributed\.comm\.tls"),
        started_engine("tls://127.0.0.1:9", None),
    ):
        pass


def test_a_connection_with_tls_does_not_go_on_without(workers, monkeypatch):
    """Whoever answers for the scheduler must not lead on to workers in plain text."""
    asked, security = [], workers.client.security

    def client(address, *, security, **_):
        asked.append(security)
        raise OSError

    monkeypatch.setattr(distributed, "Client", client)
    files = {"ca-file": security.tls_ca_file, "client.cert": security.tls_client_cert,
             "client.key": security.tls_client_key}  # fmt: skip
    with (
        dask.config.set({f"distributed.comm.tls.{name}": text for name, text in files.items()}),
        pytest.raises(InputError),
        started_engine("tls://127.0.0.1:9", None),
    ):
        pass
    assert asked[0].require_encryption
