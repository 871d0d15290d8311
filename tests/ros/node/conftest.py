"""Drape nodes in the tests' own process and one of many avatars in another, and what they should compute."""

from __future__ import annotations

import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model


@pytest.fixture(scope="session")
def other_body(tmp_path_factory):
    """A body a tenth larger than the bundled one, in a folder of its own."""
    from drape_site import scaled_body

    path = tmp_path_factory.mktemp("bodies") / "other.glb"
    path.write_bytes(scaled_body(1.1))
    return path


@pytest.fixture(scope="session")
def leaning_draper(leaning_model_path) -> Draper:
    """The same of the garment that gravity moves."""
    model = load_garment_model(leaning_model_path)
    return Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))


@pytest.fixture(scope="session")
def shared_site(start_shared_site, other_body, model_path, leaning_model_path):
    """A node's process that dresses many avatars, for all modules. alice, bob: one garment. ann: a tank top over
    trousers, in the order of the file, which is not that of the alphabet. bea: a tank top tucked into trousers, all
    vertices given, limbs separated. guests: at most two."""
    pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")
    avatars = {
        "alice": {"garments": {"top": {"model": str(model_path)}}},
        "bob": {
            "orientation": "odometry",
            "frame_id": "bobs_root",
            "garments": {"top": {"model": str(leaning_model_path)}},
        },
        "ann": {"precision": "fp32", "garments": {"zlegs": {"model": "trousers"}, "atop": {"model": "tanktop"}}},
        "bea": {
            "precision": "fp32",
            "hide_covered": False,
            "separate_limbs": True,
            "garments": {"top": {"model": "tanktop", "tucked": True}, "legs": {"model": "trousers"}},
        },
        "guests": {"discover": "ros4hri", "garments": {"top": {"model": str(model_path)}}},
    }
    roots = [str(other_body.parent), str(model_path.parent)]
    garments = ("alice/top", "bob/top", "ann/zlegs", "ann/atop", "bea/top", "bea/legs")
    return start_shared_site({"asset_roots": roots, "max_bodies": 2, "avatars": avatars}, garments)


@pytest.fixture(scope="module")
def site(shared_site, site_environment):
    """The same, while all that others of this process do in ROS is in its domain, too."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    with pytest.MonkeyPatch.context() as patch:
        for name, value in site_environment.items():
            patch.setenv(name, value)
        shared_site.clouds.clear()
        if shared_site.call(GetState, "get_state").current_state.label != "active":
            for label in ("configure", "activate"):
                shared_site.call(ChangeState, "change_state", transition=Transition(label=label))
        for avatar in ("alice", "bob", "ann", "bea"):
            shared_site.publisher(f"/{avatar}/joint_states")
        shared_site.until(lambda: "alice/top" in shared_site.statuses, "diagnostics")
        yield shared_site
