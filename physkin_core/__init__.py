"""PhySkin run time: drape a trained garment on any avatar, on one CPU core."""

from physkin_core.avatar.avatar import Avatar, AvatarError, AvatarWarning, avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.model.fabric import FABRICS, Fabric, with_fabric
from physkin_core.model.garment import Garment, GarmentError, load_garment
from physkin_core.model.garment_model import GarmentModel, GarmentModelError, Material
from physkin_core.model.model_file import ModelFileError, load_garment_model, save_garment_model
from physkin_core.motion.landmark_files import load_landmarks
from physkin_core.motion.landmarks import LandmarkReader
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit import Outfit
from physkin_core.points.splat_draper import SplatDraper
from physkin_core.points.splats import Splats
from physkin_core.rig.bone_rotations import BoneRotations
from physkin_core.rig.rig import DegreeOfFreedom, Rig, RigError
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY, FrameInput
from physkin_core.runtime.layer import Layer, WornGarment
from physkin_core.separation.limb_separator import LimbSeparator

__all__ = [
    "BUNDLED_AVATAR",
    "FABRICS",
    "UPRIGHT_GRAVITY",
    "Avatar",
    "AvatarError",
    "AvatarWarning",
    "BodyModel",
    "BoneRotations",
    "DegreeOfFreedom",
    "Draper",
    "Fabric",
    "FrameInput",
    "Garment",
    "GarmentError",
    "GarmentModel",
    "GarmentModelError",
    "LandmarkReader",
    "Layer",
    "LimbSeparator",
    "Material",
    "ModelFileError",
    "Motion",
    "MotionError",
    "Outfit",
    "Rig",
    "RigError",
    "SplatDraper",
    "Splats",
    "WornGarment",
    "avatar_from_body",
    "bundled_motions",
    "load_avatar",
    "load_body_model",
    "load_garment",
    "load_garment_model",
    "load_landmarks",
    "load_motion",
    "with_fabric",
    "save_garment_model",
]
