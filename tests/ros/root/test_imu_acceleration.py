"""What an IMU's acceleration comes to."""

from __future__ import annotations

import numpy as np
import pytest
from root_messages import imu
from scipy.spatial.transform import Rotation

from physkin_core.runtime.frame_input import STANDARD_GRAVITY
from physkin_ros.root import imu_acceleration
from physkin_ros.root.imu_acceleration import DELAY, ImuAcceleration
from physkin_ros.root.quaternions import OrientationError


@pytest.fixture
def at_once(monkeypatch):
    """Nothing is smoothed."""
    monkeypatch.setattr(imu_acceleration, "DELAY", 1e-12)


class Felt(ImuAcceleration):
    """What is felt (3,), in units of gravity."""

    def effective_gravity(self, message, stamp_ns):
        gravity = super().effective_gravity(message, stamp_ns)
        return None if gravity is None else gravity.vector / STANDARD_GRAVITY


def pushed(rate: float, seconds: float = 0.25, *, oriented: bool = True, turn: Rotation | None = None):
    """What is felt last, of an upright root that is at rest, then accelerated by 4 m/s2 along the world's X."""
    turn = turn or Rotation.identity()
    acceleration = Felt()
    quaternion = tuple(turn.as_quat().tolist()) if oriented else None
    felt = acceleration.effective_gravity(imu(1.0, turn.inv().apply([0, 0, 9.81]).tolist(), quaternion), 1_000_000_000)
    np.testing.assert_allclose(felt, turn.inv().apply([0, 0, -1]), atol=1e-9)
    force = turn.inv().apply([4.0, 0.0, 9.81]).tolist()
    for k in range(1, round(seconds * rate) + 1):
        felt = acceleration.effective_gravity(imu(1.0, force, quaternion), 1_000_000_000 + round(1e9 * k / rate))
    return felt


@pytest.mark.parametrize("oriented", [True, False])
def test_first_order_low_pass(oriented):
    """The step comes through as one less an exponential of the stated delay, whatever the rate and the orientation."""
    turn = Rotation.from_euler("xyz", [0.3, -0.8, 1.0])
    share = 1 - np.exp(-0.25 / DELAY)
    for rate in (20.0, 400.0):
        felt = pushed(rate, oriented=oriented, turn=turn)
        np.testing.assert_allclose(turn.apply(felt), [-share * 4 / 9.81, 0, -1], atol=1e-6)


def test_gravity_turns_at_once():
    """With an orientation the low pass holds back no turn of a root at rest."""
    acceleration = Felt()
    for k in range(20):
        turn = Rotation.from_euler("y", 0.1 * k)
        force = turn.inv().apply([0, 0, 9.81]).tolist()
        felt = acceleration.effective_gravity(
            imu(0, force, tuple(turn.as_quat().tolist())), 1_000_000_000 + k * 10_000_000
        )
        np.testing.assert_allclose(felt, turn.inv().apply([0, 0, -1]), atol=1e-9)


def test_gaps_and_stamps(at_once):
    """After a pause, or on a new clock, the root is at rest; doubled, late and unstamped messages say nothing."""
    acceleration, push = Felt(), imu(0, (4.0, 0, 9.81), (0.0, 0.0, 0.0, 1.0))
    at = lambda seconds: acceleration.effective_gravity(push, round(1e9 * seconds))  # noqa: E731
    assert at(100)[0] == 0 and at(100.1)[0] < -0.4
    assert at(100.1) is None and at(100.05) is None and at(0) is None
    assert at(100.7)[0] == 0 and at(100.8)[0] < -0.4 and at(50)[0] == 0
    nothing = imu(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert acceleration.effective_gravity(nothing, 51_000_000_000) is None
    push.linear_acceleration_covariance[0] = -1.0
    assert at(51) is None


def test_at_most_three_times_gravity(at_once):
    """As training knows no more; beyond what is measured on a body it is refused."""
    acceleration = Felt()
    for k in range(2):
        felt = acceleration.effective_gravity(imu(0, (0.0, 0.0, 99.0)), 1_000_000_000 + k * 10_000_000)
    np.testing.assert_allclose(felt, [0, 0, -3 * 0.9999], rtol=1e-7)
    assert np.linalg.norm(felt) < 3
    for wrong in ((np.nan, 0, 0), (0, 0, 2000.0), (np.inf, 0, 0)):
        with pytest.raises(OrientationError, match="linear acceleration is"):
            acceleration.effective_gravity(imu(0, wrong), 2_000_000_000)


@pytest.mark.parametrize("oriented", [True, False])
def test_gravity_at_rest_is_told_with_it(oriented, at_once):
    """The direction that the IMU gives, of its orientation or of what it feels now, in m/s2."""
    turn, push = Rotation.from_euler("y", 0.3), (4.0, 0.0, 9.81)
    down = turn.inv().apply([0, 0, -1]) if oriented else -np.array(push) / np.linalg.norm(push)
    acceleration = ImuAcceleration()
    for k in range(2):
        message = imu(0, push, tuple(turn.as_quat().tolist()) if oriented else None)
        felt = acceleration.effective_gravity(message, 1_000_000_000 + k * 10_000_000)
    np.testing.assert_allclose(felt.at_rest, 9.81 * down, atol=1e-9)
    np.testing.assert_allclose(felt.vector, -np.array(push), atol=1e-9)
