"""``qrsim ros2``: what is refused before anything flies."""

import pytest

from qrsim import cli


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--realtime", "0"], "--realtime 0: expected 0.001 to 1000"),
        (["--seed", "-1"], "--seed -1: expected an integer from 0 to 2**63 - 1"),
        (["--hold", "0"], "--hold 0: expected 0.01 to 3600 seconds"),
        (["--duration", "-1"], "--duration -1: expected more than 0 seconds"),
        (["--api", "mavrs"], "--api mavrs: expected qrsim, mavros, px4; did you mean 'mavros'?"),
        (["--api", "px4", "--pace", "barrier"], "--pace barrier: --api px4 has a flight stack"),
        (["--namespaces", "uav{n}"], "--namespaces uav{n}: is for --api mavros and --api px4"),
    ],
)
def test_what_cannot_be_meant_is_refused(words, said, capsys):
    assert cli.main(["ros2", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--domain", "233"], "domain 233: expected 0 to 232, as ROS_DOMAIN_ID"),
        (["--domain", "-1"], "domain -1: expected 0 to 232"),
        (["--distro", "jazy"], "distribution 'jazy': expected humble, iron, jazzy, kilted, lyrical"),
        (["outdor_patrol"], "did you mean 'outdoor_patrol'?"),
    ],
)
def test_what_there_is_not_is_refused(words, said, capsys):
    pytest.importorskip("cyclonedds")
    pytest.importorskip("rosbags")
    assert cli.main(["ros2", *words]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert found.count("\n") == 1


def test_the_domain_of_the_environment(monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    assert cli.main(["ros2"]) == 2
    assert "ROS_DOMAIN_ID is 'seven': expected a number" in capsys.readouterr().err


def test_without_an_interface_the_run_fails_in_one_line(monkeypatch, capsys, tmp_path):
    pytest.importorskip("cyclonedds")
    pytest.importorskip("rosbags")
    nowhere = '<NetworkInterface name="nowhere0"/>'
    uri = f"<CycloneDDS><Domain><General><Interfaces>{nowhere}</Interfaces></General></Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    assert cli.main(["ros2", "hover_ideal", "--domain", "231"]) == 1
    found = capsys.readouterr().err
    assert "DDS does not start in domain 231: no network interface" in found
    assert found.count("\n") == 1
