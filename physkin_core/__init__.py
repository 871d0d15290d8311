"""PhySkin run time: drape a trained garment on any avatar, on one CPU core."""

from physkin_core.avatar.avatar import Avatar, AvatarError, AvatarWarning, avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.model.fabric import FABRICS, Fabric, made_of
from physkin_core.model.garment import Garment, GarmentError, load_garment
from physkin_core.model.garment_model import GarmentModel, GarmentModelError, Material
from physkin_core.model.model_file import ModelFileError, load_garment_model, save_garment_model
from physkin_core.model.skinning import NORMALS
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.outfit.layers import OutfitGarment
from physkin_core.outfit.outfit import Outfit
from physkin_core.points.splat_draper import SplatDraper
from physkin_core.points.splats import Splats
from physkin_core.rig.bone_rotations import BoneRotations
from physkin_core.rig.rig import DegreeOfFreedom, Rig, RigError
from physkin_core.runtime.draper import BACKENDS, UPRIGHT_GRAVITY, Draper
from physkin_core.separation.limb_separator import LimbSeparator
from physkin_core.sway.pendulum import PendulumSettings
from physkin_core.sway.sway import Sway

__all__ = [
    "BACKENDS",
    "BUNDLED_AVATAR",
    "FABRICS",
    "NORMALS",
    "UPRIGHT_GRAVITY",
    "Avatar",
    "AvatarError",
    "AvatarWarning",
    "BodyModel",
    "BoneRotations",
    "DegreeOfFreedom",
    "Draper",
    "Fabric",
    "Garment",
    "GarmentError",
    "GarmentModel",
    "GarmentModelError",
    "LimbSeparator",
    "Material",
    "ModelFileError",
    "Motion",
    "MotionError",
    "Outfit",
    "OutfitGarment",
    "PendulumSettings",
    "Rig",
    "RigError",
    "SplatDraper",
    "Splats",
    "Sway",
    "avatar_from_body",
    "bundled_motions",
    "load_avatar",
    "load_body_model",
    "load_garment",
    "load_garment_model",
    "load_motion",
    "made_of",
    "save_garment_model",
]
