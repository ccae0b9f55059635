"""The network of the cameras, judged; and the integrator's page, which must name every topic."""

import re
from ipaddress import IPv4Address, IPv4Interface
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.cli.camera import camera
from cellctl.desk import camera_check, camera_network
from cellctl.desk.camera_network import (
    MIB,
    Finding,
    kernel_findings,
    network_findings,
    packet_finding,
    shared_findings,
)
from cellctl.faults import FAULTS
from drivers.network import Nic, Receiving

CAMERA = IPv4Address("192.168.10.31")
GOOD = Nic("eth1", IPv4Interface("192.168.10.5/24"), 9000, 1000, "up")
LOOPBACK = Nic("lo", IPv4Interface("127.0.0.1/8"), 65536, None, "unknown")


def by_topic(findings: object) -> dict[str, Finding]:
    return {finding.topic: finding for finding in findings}  # type: ignore[attr-defined]


def test_a_good_card_has_nothing_to_be_said_against_it():
    assert all(finding.ok for finding in network_findings("camera 1", CAMERA, GOOD))
    assert all(finding.ok for finding in kernel_findings(Receiving(32 * MIB, 8192)))
    assert packet_finding("camera 1", 8996, GOOD).ok


@pytest.mark.parametrize(
    ("nic", "topic", "ok", "says"),
    [
        (None, "network", False, "there is no way to 192.168.10.31"),
        (GOOD._replace(interface=IPv4Interface("10.0.0.5/8")), "network", False, "in no network of this computer"),
        (GOOD._replace(link="down"), "link", False, "eth1 has no link: check cable"),
        (GOOD._replace(link_mbps=100), "link", False, "runs at 100 Mb/s: use a cable of category 5e"),
        (GOOD._replace(link_mbps=None), "link", None, "does not say how fast"),
        (GOOD._replace(mtu_bytes=1500), "mtu", None, "9000 cost less time: `ip link set eth1 mtu 9000`"),
        (GOOD._replace(mtu_bytes=1400), "mtu", False, "packets of 1400 bytes only"),
    ],
)
def test_what_is_wrong_with_the_way_comes_with_its_remedy(nic: Nic | None, topic: str, ok: bool | None, says: str):
    finding = by_topic(network_findings("camera 1", CAMERA, nic))[topic]
    assert finding.ok is ok
    assert says in finding.text


def test_on_loopback_cable_and_packet_size_are_no_topic():
    assert set(by_topic(network_findings("camera 1", IPv4Address("127.0.0.2"), LOOPBACK))) == {"network"}


@pytest.mark.parametrize(("buffer_bytes", "ok"), [(212_992, False), (4 * MIB, None), (32 * MIB, True)])
def test_a_stock_receive_buffer_is_wrong_and_a_small_one_worth_a_note(buffer_bytes: int, ok: bool | None):
    finding = by_topic(kernel_findings(Receiving(buffer_bytes, 8192)))["buffer"]
    assert finding.ok is ok
    assert ("sysctl -w net.core.rmem_max=33554432" in finding.text) is not (ok is True)


def test_two_cameras_on_one_card_are_told_to_share_or_to_part():
    (finding,) = shared_findings({"camera 1": GOOD, "camera 2": GOOD})
    assert "GevSCPD" in finding.text
    other = GOOD._replace(name="eth2")
    assert not list(shared_findings({"camera 1": GOOD, "camera 2": other}))
    assert not list(shared_findings({"camera 1": LOOPBACK, "camera 2": LOOPBACK}))


def test_small_packets_on_a_card_that_takes_large_ones_point_at_the_switch():
    assert "a switch or the camera does not" in packet_finding("camera 1", 1500, GOOD).text
    assert packet_finding("camera 1", 1500, GOOD._replace(mtu_bytes=1500)).ok


@given(
    st.one_of(
        st.none(),
        st.builds(
            Nic,
            st.sampled_from(["eth0", "lo"]),
            st.ip_addresses(v=4).map(lambda address: IPv4Interface(f"{address}/24")),
            st.none() | st.integers(68, 65536),
            st.none() | st.integers(1, 400_000),
            st.none() | st.sampled_from(["up", "down", "unknown", "lowerlayerdown"]),
        ),
    ),
    st.ip_addresses(v=4),
)
@settings(max_examples=40, deadline=None)
def test_any_card_gets_a_judgement_and_what_is_wrong_a_remedy(nic: Nic | None, address: IPv4Address):
    findings = list(network_findings("camera 1", address, nic))
    assert findings
    assert all(":" in finding.text for finding in findings if finding.ok is False)


# The integrator's page

PAGE = (Path(__file__).parent.parent / "drivers" / "CAMERAS.md").read_text()


def topics_in_the_code() -> set[str]:
    found: set[str] = set()
    for module in (camera_network, camera_check):
        text = Path(str(module.__file__)).read_text()
        found |= set(re.findall(r'Finding\([\w.\s"]+?, "(\w+)",', text))
    return found


def test_the_page_explains_every_topic_of_the_check_and_no_other():
    section = PAGE.partition("## What `cellctl camera check` says")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)) == topics_in_the_code()


def test_the_page_explains_every_error_of_a_camera_with_its_code():
    section = PAGE.partition("## What each error means")[2].partition("\n## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` (\w+) \|", section, re.MULTILINE))
    codes = {kind.__name__: fault.code for kind, fault in FAULTS.items()}
    assert set(rows) == {"LinkLost", "NoAnswer", "Refused", "Mismatch", "FrameLost", "Unavailable"}
    assert rows == {name: codes[name] for name in rows}


@pytest.mark.parametrize("path", re.findall(r"`((?:deploy|drivers|cellctl)/[\w./-]+)`", PAGE))
def test_files_that_the_page_names_are_there(path: str):
    assert (Path(__file__).parent.parent / path).exists()


@pytest.mark.parametrize("command", sorted(set(re.findall(r"cellctl camera ([a-z][a-z-]+)", PAGE))))
def test_commands_that_the_page_names_are_there(command: str):
    assert command in camera.commands


def test_the_numbers_on_the_page_are_those_of_the_code():
    settings = (Path(__file__).parent.parent / "deploy" / "90-cellctl.sysctl.conf").read_text()
    for key in ("net.core.rmem_max", "net.core.netdev_max_backlog"):
        value = re.search(rf"{re.escape(key)} ?= ?(\d+)", settings)
        assert value is not None
        assert f"{key}={value[1]}" in camera_network.SYSCTL.format(key=key, value=value[1])
        assert f"`{key} = {value[1]}`" in PAGE
