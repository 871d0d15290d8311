"""Cloth that swings: the pendulum against its equation and the reference, and what messages may do."""

import math

import numpy as np
import pytest
from native_frames import NativeFrameInput
from reference.frame_input import ReferenceFrameInput
from reference.pendulum import LARGEST_GAP, LARGEST_TWIST, Pendulum, Settings
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from physkin_core.sway.frame_input import FrameInput


class Sway:
    """What a garment that a pendulum moves is given."""

    def __init__(self, amount=1.0):
        self._input = FrameInput([False])
        self._input.sways = [amount]
        self.reset = self._input.reset

    def felt(self, time, root):
        """Effective gravity (3,) [m/s2]."""
        self._input.fill(time=time, root=root)
        return 9.81 * self._input.rows[0, :3].astype(np.float64)

    @property
    def twist(self):
        return float(self._input.rows[0, 3])


STILL = (0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0)


def rooted(position, orientation=(0.0, 0.0, 0.0, 1.0)):
    return np.array([*position, *orientation])


def strolling(t):
    """Position of a root that walks, sways and stops."""
    ahead = 1.2 * min(t, 2.0)
    return np.array([ahead, 0.08 * math.sin(2 * math.pi * 1.3 * t), 0.9 + 0.03 * math.cos(2 * math.pi * 2.0 * t)])


def felt_of(deflection):
    """What is felt of a deflection along one axis."""
    share = deflection**2 / (deflection**2 + 0.25**2)
    return share * deflection / math.sqrt(1 + (deflection / 19.62) ** 2)


def felt_at_end(times, path=strolling, **options):
    sway = Sway(**options)
    for t in times:
        felt = sway.felt(t, rooted(path(t)))
    return felt


@pytest.mark.parametrize("settings", [Settings(), Settings(damping=60.0), Settings(damping=0)])
def test_the_closed_form_is_the_equation(settings):
    """Of the reference: a root at constant acceleration, against an integrator of small steps."""
    acceleration, dt, steps = 1.5, 1 / 240, 480
    pendulum = Pendulum(settings)
    for k in range(steps + 1):
        t = k * dt
        felt, _ = pendulum.felt(t, rooted((acceleration * t * t / 2, 0.0, 0.0)), 1.0)
    w = 2 * math.pi * settings.frequency

    def equation(t, state):
        equilibrium = -settings.gain * (acceleration + settings.air_drag * acceleration * t)
        return state[1], -(w**2) * (state[0] - equilibrium) - settings.damping * state[1]

    exact = solve_ivp(equation, (0, steps * dt), (0.0, 0.0), rtol=1e-9, atol=1e-9).y[0, -1]
    assert felt[0] == pytest.approx(felt_of(exact), abs=0.03 * (1 + abs(exact)))
    assert felt[1] == 0


def turned(angle):
    return rooted((0, 0, 0.9), Rotation.from_euler("z", angle).as_quat())


def turning(t):
    """Yaw of a root that turns by 180 degrees from 0.5 to 1.1 s."""
    u = min(max((t - 0.5) / 0.6, 0), 1)
    return math.pi * u**3 * (10 - 15 * u + 6 * u**2)


@pytest.mark.parametrize("settings", [Settings(), Settings(twist_damping=60.0)])
def test_the_twist_is_a_torsion_pendulum(settings):
    """Of the reference: a root that turns faster and faster, against an integrator of small steps."""
    acceleration, dt, steps = 3.0, 1 / 240, 300
    pendulum = Pendulum(settings)
    for k in range(steps + 1):
        felt, twist = pendulum.felt(k * dt, turned(acceleration * (k * dt) ** 2 / 2), 1.0)
    w = 2 * math.pi * settings.frequency

    def equation(t, state):
        force = -acceleration - settings.air_drag * acceleration * t
        return state[1], -(w**2) * state[0] - settings.twist_damping * state[1] + force

    exact = solve_ivp(equation, (0, steps * dt), (0.0, 0.0), rtol=1e-9, atol=1e-9).y[0, -1]
    assert twist == pytest.approx(exact / math.sqrt(1 + (exact / LARGEST_TWIST) ** 2), rel=0.03)
    assert felt == pytest.approx([0, 0, -9.81])


def twists_of(rate, seconds=4.0, **options):
    sway, found = Sway(**options), []
    for k in range(round(seconds * rate) + 1):
        sway.felt(k / rate, turned(turning(k / rate)))
        found.append(sway.twist)
    return np.array(found)


def test_cloth_stays_behind_a_turn_swings_ahead_and_comes_to_rest():
    found = twists_of(60)
    assert found.min() < -0.3 and found[60:].max() > 0.1
    assert np.abs(found).max() < LARGEST_TWIST
    assert abs(found[-1]) < 1e-3
    assert twists_of(60, amount=0.5) == pytest.approx(found / 2)
    assert (twists_of(60, amount=0.0) == 0).all()


def test_at_any_rate_it_twists_the_same():
    at = [twists_of(rate)[:: rate // 15] for rate in (15, 30, 60, 120)]
    assert max(np.sqrt(((a - at[-1]) ** 2).mean()) for a in at) < 0.03


@pytest.mark.parametrize("way", ["x", "y"])
def test_who_turns_about_another_axis_twists_nothing(way):
    sway = Sway()
    for k in range(60):
        sway.felt(k / 60, rooted((0, 0, 0), Rotation.from_euler(way, 3 * k / 60).as_quat()))
        assert abs(sway.twist) < 1e-6


def test_who_lies_and_rolls_twists_nothing():
    sway = Sway()
    lying = Rotation.from_euler("y", math.pi / 2)
    for k in range(60):
        sway.felt(k / 60, rooted((0, 0, 0), (lying * Rotation.from_euler("z", 3 * k / 60)).as_quat()))
        assert abs(sway.twist) < 1e-6


def test_a_root_that_was_put_another_way_round_twists_nothing():
    sway = Sway()
    for k in range(20):
        sway.felt(k / 60, turned(0.0 if k < 10 else 2.5))
        assert abs(sway.twist) < 1e-6


@pytest.mark.parametrize("sign", [1, -1])
def test_a_quaternion_and_its_negative_are_one_turn(sign):
    sway = Sway()
    for k in range(30):
        root = turned(0.1 * k)
        root[3:] *= sign ** (k % 2)
        sway.felt(k / 60, root)
    assert sway.twist < -0.1


def test_rows_are_those_of_the_reference():
    """Of garments that a pendulum or a sway network moves, as much as each is told, over frames at several rates,
    doubled, gaps, jumps, clocks that go back, and a root of any speed."""
    generator, learnt, amounts = np.random.default_rng(3), (False, False, True, True, False), (1.0, 0.4, 1.0, 0.4, 0.0)
    native, reference = (make(learnt) for make in (NativeFrameInput, ReferenceFrameInput))
    t, turn, seen = 0.0, Rotation.identity(), []
    for _ in range(300):
        t += generator.choice([1 / 120, 1 / 60, 1 / 15, 0.28, 0.0, -0.1, 0.5])
        turn = turn * Rotation.from_rotvec(generator.normal(size=3) * generator.choice([0.01, 0.1, 0.2, 2.0]))
        scale = generator.choice([0.01, 0.1, 2.0, 1e6], p=[0.4, 0.3, 0.28, 0.02])
        root = rooted(generator.normal(size=3) * scale, turn.as_quat())
        found, expected = (each.rows(t, root, amounts) for each in (native, reference))
        np.testing.assert_allclose(found, expected, atol=1e-6, rtol=1e-6)
        seen.append(np.abs(expected))
    largest = np.max(seen, axis=0)
    assert largest[0, 3] > 0.1 and largest[2, 8] == 1e6


def test_at_any_rate_the_same():
    at = [felt_at_end(np.arange(round(1.8 * rate) + 1) / rate) for rate in (15, 30, 60, 120)]
    largest = max(np.linalg.norm(a - b) for a in at for b in at)
    assert largest < 0.1 * np.linalg.norm(at[-1] - [0, 0, -9.81])


def test_standing_it_feels_gravity_alone_and_walking_it_trails():
    assert felt_at_end(np.arange(60) / 60, lambda t: np.zeros(3)) == pytest.approx([0, 0, -9.81], abs=2e-6)
    steady = felt_at_end(np.arange(600) / 60, lambda t: np.array([t, 0.0, 0.0]))
    settings = Settings()
    trailing = -settings.gain * settings.air_drag
    assert steady[0] == pytest.approx(felt_of(trailing), rel=1e-6)
    assert steady[2] == pytest.approx(-9.81)


def test_after_a_stop_it_swings_on_and_comes_to_rest():
    sway, ahead = Sway(), []
    for k in range(480):
        ahead.append(sway.felt(k / 60, rooted((1.4 * min(k / 60, 2.0), 0, 0)))[0])
    assert min(ahead[:120]) < -2
    assert max(ahead[120:]) > 2, "cloth does not swing ahead when its wearer stops"
    assert max(abs(value) for value in ahead[300:]) < 0.02


def test_it_is_felt_in_the_root_frame():
    down = Sway().felt(0.0, rooted((1, 2, 3), Rotation.from_euler("xyz", (0.4, -0.9, 2.0)).as_quat()))
    assert down == pytest.approx(Rotation.from_euler("xyz", (0.4, -0.9, 2.0)).inv().apply([0, 0, -9.81]))


def test_amount_is_between_nothing_and_all():
    times = np.arange(100) / 60
    whole, half, none = (felt_at_end(times, amount=amount) for amount in (1.0, 0.5, 0.0))
    assert none == pytest.approx([0, 0, -9.81])
    assert half == pytest.approx((whole + none) / 2)


@pytest.mark.parametrize("disturbance", ["gap", "jump", "back", "twice"])
def test_disturbed_messages_do_not_pop(disturbance):
    """From one frame to the next cloth never feels more of a change than in undisturbed motion."""
    sway, path = Sway(), []
    t, shift = 0.0, np.zeros(3)
    for k in range(240):
        t += 1 / 60
        if k == 120:
            t += {"gap": 2 * LARGEST_GAP, "back": -5.0}.get(disturbance, 0.0)
            shift += {"jump": [0.0, 5.0, 0.0]}.get(disturbance, [0.0, 0.0, 0.0])
        root = rooted(strolling(k / 60) + shift)
        felt = sway.felt(t, root)
        if disturbance == "twice":
            assert (sway.felt(t, root) == felt).all()
        path.append(felt)
    change = np.linalg.norm(np.diff(path, axis=0), axis=1)
    longest = 2 * LARGEST_GAP * 60 if disturbance == "gap" else 1  # a gap is that many frames long
    assert change[119] <= longest * change[:100].max()
    assert change[120:].max() <= 1.5 * change[:118].max()


def test_an_hour_of_anything_stays_finite_and_bounded():
    generator, sway, t = np.random.default_rng(0), Sway(), 0.0
    steps = generator.choice([1e-9, 1 / 120, 1 / 60, 0.2, 3.0, -1.0, 0.0], size=20000)
    places = generator.normal(size=(20000, 3)) * generator.choice([1e-3, 1.0, 1e6], size=(20000, 1))
    turns = Rotation.random(20000, random_state=1).as_quat()
    for step, place, turn in zip(steps, places, turns):
        t += step
        felt = sway.felt(t, rooted(place, turn))
        assert np.isfinite(felt).all() and np.linalg.norm(felt) <= 3 * 9.81 + 1e-9
        assert abs(sway.twist) < LARGEST_TWIST


def test_reset_forgets():
    sway, fresh = Sway(), Sway()
    for k in range(60):
        sway.felt(k / 60, rooted(strolling(k / 60)))
    for k in range(4):
        sway.felt(0.99 + 0.02 * k, turned(0.1 * max(k - 1, 0)))
    assert sway.twist < -0.01
    sway.reset()
    assert (sway.felt(7.0, STILL) == fresh.felt(7.0, STILL)).all() and sway.twist == 0


@pytest.mark.parametrize(
    ("time", "root", "said"),
    [
        (math.nan, STILL, "finite"),
        (0.0, (*STILL[:6], math.inf), "finite"),
        (0.0, STILL[:6], "shape"),
        (0.0, (1e12, *STILL[1:]), "within"),
        (0.0, (0, 0, 0, 0, 0, 0, 0), "length 1"),
    ],
)
def test_bad_roots_are_refused(time, root, said):
    with pytest.raises(ValueError, match=said):
        Sway().felt(time, root)


@pytest.mark.parametrize("amount", [-0.1, 1.1, math.nan, "all", None, np.array(0.5), np.array([0.5])])
def test_bad_amounts_are_refused(amount):
    with pytest.raises(ValueError, match="must be a number from 0 to 1, got"):
        Sway(amount=amount)
