"""Who is before the camera, or in a film, as a ROS4HRI body (REP-155): `python camera_joint_states.py [FILM [ID]]`.

Needs `pip install mediapipe==0.10.21`, which brings OpenCV and its models. Joints have the rig's names, in radians; the
root is the frame body_ID in the frame world. Pictures leave this process for nowhere.
"""

import sys
import time

import cv2
import mediapipe
import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from physkin_core import LandmarkReader, load_body_model

film, body = [*sys.argv[1:3], *("", "camera")[len(sys.argv[1:3]) :]]
pictures = cv2.VideoCapture(film or 0)
if not pictures.isOpened():
    sys.exit(f"error: {film or 'the first camera'} cannot be opened")
step = 1 / (pictures.get(cv2.CAP_PROP_FPS) or 30.0) if film else 0.0  # [s] to wait for; a camera waits by itself
finder = mediapipe.solutions.pose.Pose(model_complexity=1, smooth_landmarks=False)
reader, names = LandmarkReader("mediapipe"), load_body_model().rig.joint_names
nobody = np.full((len(mediapipe.solutions.pose.PoseLandmark), 4), np.nan)

rclpy.init()
node = rclpy.create_node("camera_joint_states")
states = node.create_publisher(JointState, f"/humans/bodies/{body}/joint_states", 5)
transforms = node.create_publisher(TFMessage, "/tf", 5)
said, began, frame = "", time.monotonic(), 0
try:
    while rclpy.ok() and (picture := pictures.read()[1]) is not None:
        time.sleep(max(0.0, began + frame * step - time.monotonic()))
        found = finder.process(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)).pose_world_landmarks
        points = np.array([[p.x, p.y, p.z, p.visibility] for p in found.landmark]) if found else nobody
        seconds = frame * step if film else time.monotonic() - began
        positions, root = reader.read(points[:, :3], points[:, 3], time_s=seconds)
        place = TransformStamped(child_frame_id=f"body_{body}")
        place.header.frame_id, place.header.stamp = "world", node.get_clock().now().to_msg()
        for part, axes in ((place.transform.translation, "xyz"), (place.transform.rotation, "xyzw")):
            for axis, value in zip(axes, root if axes == "xyz" else root[3:]):
                setattr(part, axis, float(value))
        transforms.publish(TFMessage(transforms=[place]))
        states.publish(JointState(header=place.header, name=names, position=positions.tolist()))
        sees = ", ".join([reader.status, *(f"no {part}" for part in reader.lost)])
        if sees != said:
            print(sees, flush=True)
        said, frame = sees, frame + 1
except KeyboardInterrupt:
    pass
