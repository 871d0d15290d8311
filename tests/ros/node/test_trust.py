"""What the node must not do: open sockets of its own, unpickle or evaluate files and messages, do without security."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import physkin_core
from physkin_core import BUNDLED_AVATAR, Draper, load_avatar

ROOT = Path(physkin_core.__file__).parents[1]
FORBIDDEN_MODULES = {
    "asyncio", "cPickle", "cloudpickle", "dill", "ftplib", "http", "joblib", "marshal", "pickle", "requests", "shelve",
    "smtplib", "socket", "socketserver", "ssl", "telnetlib", "urllib.request", "xmlrpc",
}  # fmt: skip
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.load", "torch.load"}
EXCEPTIONS = {
    ("physkin_core/worker/shared_arrays.py", "pickle"),  # of the process that loads
    ("physkin_ros/middleware/transport.py", "socket"),  # looks for a free domain, for demo, bench and tests
    ("physkin_core/cluster/cluster.py", "socket"),  # asks whether a cluster answers where its user says
    ("physkin_core/view/page.py", "socket"),  # the page listens, as its user asks
    ("physkin_core/extras.py", "urllib.request"),  # the path of a file: address
}
WATCHED = """
import sys
def watch(event, arguments):
    if event == "open" and str(arguments[0]).endswith((".safetensors", ".glb")):
        print("AUDIT", event, arguments, file=sys.stderr, flush=True)
    if event.split(".")[0] in ("socket", "pickle", "marshal", "ftplib", "urllib", "subprocess", "os.system"):
        loads = event == "subprocess.Popen" and "physkin_core.loader.loading_process" in arguments[1]
        loads |= event == "pickle.find_class" and arguments[0].split(".")[0] in ("physkin_core", "numpy")
        if event != "marshal.loads" and not loads:  # of compiled modules; the process that loads, and what it says
            print("AUDIT", event, arguments, file=sys.stderr, flush=True)
sys.addaudithook(watch)
from physkin_ros.node.node_process import main
sys.exit(main(sys.argv[1:]))
"""


def offences(source: str, name: str) -> list[str]:
    """Imports and calls that have no place in a node that strangers talk to."""
    found = []
    for part in ast.walk(ast.parse(source)):
        modules = []
        if isinstance(part, ast.Import):
            modules = [alias.name for alias in part.names]
        elif isinstance(part, ast.ImportFrom) and not part.level:
            modules = [part.module, *(f"{part.module}.{alias.name}" for alias in part.names)]
        for module in modules:
            bad = {module, module.split(".")[0]} & FORBIDDEN_MODULES
            if bad and (name, module) not in EXCEPTIONS:
                found.append(f"{name}:{part.lineno} imports {module}")
        if isinstance(part, ast.Call):
            if ast.unparse(part.func) in FORBIDDEN_CALLS:
                found.append(f"{name}:{part.lineno} calls {ast.unparse(part.func)}")
            for keyword in part.keywords:
                if keyword.arg == "allow_pickle" and ast.unparse(keyword.value) != "False":
                    found.append(f"{name}:{part.lineno} allows pickles")
    return found


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from urllib import request", "import http.client", "eval('1')", "f(allow_pickle=True)"],
)
def test_offences_are_found(source):
    """The scan can fail."""
    assert len(offences(source, "x.py")) >= 1


@pytest.mark.parametrize("package", ["physkin_core", "physkin_ros"])
def test_sources_open_no_socket_and_unpickle_nothing(package):
    """Neither package imports what would, with exceptions that the node never calls."""
    files = sorted((ROOT / package).rglob("*.py"))
    assert len(files) > 20
    assert not [line for file in files for line in offences(file.read_text(), str(file.relative_to(ROOT)))]


def test_running_node_opens_dds_ports_only(peer, domain, garment_model, model_path):
    """No Python code in it makes a socket, unpickles other things than PhySkin's own from the process that loads, opens
    what it wears or starts another process; the system knows of UDP ports of DDS only, and of none of that process."""
    draper = Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
    command = [sys.executable, "-c", WATCHED, "--ros-args", "-p", f"model:={model_path}"]
    node = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        peer.connect()
        peer.cloud(draper.joint_names, garment_model.rig.rest, (1, 0))
        tcp, udp, listening = sockets(node.pid)
        (loading,) = child_processes(node.pid)
        assert sockets(loading) == (set(), set(), set())
        node.terminate()
        output, _ = node.communicate(timeout=20)
    finally:
        node.kill()
        node.wait()
    assert node.returncode == 0 and "AUDIT" not in output, output
    assert not tcp and not listening
    ephemeral = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    served = {port for port in udp if port and port < ephemeral}
    first = 7400 + 250 * domain
    shared_memory = range(7000, 7400)  # Fast DDS reserves a number there for its shared-memory ports
    assert served and all(port in range(first, first + 250) or port in shared_memory for port in served)


def child_processes(pid: int) -> list[int]:
    """Of all threads of a process."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for thread in threads for child in (thread / "children").read_text().split()]


def sockets(pid: int) -> tuple[set[int], set[int], set[str]]:
    """Local TCP ports and UDP ports of a process, and its listening UNIX sockets."""
    targets = []
    for descriptor in os.listdir(f"/proc/{pid}/fd"):
        with suppress(FileNotFoundError):  # closed meanwhile
            targets.append(os.readlink(f"/proc/{pid}/fd/{descriptor}"))
    inodes = {target[8:-1] for target in targets if target.startswith("socket:[")}
    ports = {}
    for protocol in ("tcp", "tcp6", "udp", "udp6"):
        table = Path(f"/proc/{pid}/net/{protocol}")
        rows = [line.split() for line in table.read_text().splitlines()[1:]] if table.exists() else []
        ports[protocol] = {int(row[1].rpartition(":")[2], 16) for row in rows if row[9] in inodes}
    rows = [line.split() for line in Path(f"/proc/{pid}/net/unix").read_text().splitlines()[1:]]
    listening = {row[-1] for row in rows if row[6] in inodes and int(row[3], 16) & 0x10000}
    return ports["tcp"] | ports["tcp6"], ports["udp"] | ports["udp6"], listening


def test_security_that_is_not_there_is_not_done_without(start, model_path, tmp_path, monkeypatch):
    """With SROS 2 enforced and no key store, or a middleware built without it, the node says so and does not start."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
    (tmp_path / "enclaves" / "physkin").mkdir(parents=True)
    for name, value in (("ENABLE", "true"), ("STRATEGY", "Enforce"), ("KEYSTORE", str(tmp_path))):
        monkeypatch.setenv(f"ROS_SECURITY_{name}", value)
    node = start("physkin_ros", "--ros-args", "--enclave", "/physkin", "-p", f"model:={model_path}")
    assert node.wait(30) == 2
    lines = [line for line in node.stdout.read().splitlines() if line.startswith(("error", "Traceback"))]
    assert len(lines) == 1 and lines[0].startswith("error: ")
