"""A DDS participant without ROS (PyPI `cyclonedds`): sends joint states, receives garment clouds.

`python dds_participant.py DOMAIN STATES.npz CLOUDS.npz`: STATES holds names (d,), positions (T, d) and stamps (T, 2);
CLOUDS gets stamps (T, 2), clouds (T, n, 6) and the layout each came with. Types and topics are written down here as
ROS 2 maps them to DDS, not taken from anything of ours.
"""

import sys
import time
from dataclasses import dataclass

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

ANSWER_SECONDS = 20.0
QUALITY = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.History.KeepLast(50),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@final
@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


def main() -> int:
    domain, states, output = sys.argv[1:]
    participant = DomainParticipant(int(domain))
    writer = DataWriter(participant, Topic(participant, "rt/joint_states", JointState, qos=QUALITY))
    reader = DataReader(participant, Topic(participant, "rt/drape_node/garment", PointCloud2, qos=QUALITY))
    wait_for(writer.get_matched_subscriptions, "the node's subscription")
    wait_for(reader.get_matched_publications, "the garment's publisher")
    time.sleep(0.3)
    stamps, clouds, layouts = [], [], []
    with np.load(states) as given:
        names = [str(name) for name in given["names"]]
        for positions, (sec, nanosec) in zip(given["positions"].tolist(), given["stamps"].tolist()):
            writer.write(JointState(Header(Time(sec, nanosec), ""), names, positions, [], []))
            count = len(stamps) + 1
            wait_for(lambda count=count: collect(reader, stamps, clouds, layouts) >= count, f"cloud of {sec}.{nanosec}")
    np.savez(output, stamps=stamps, clouds=clouds, layouts=layouts)
    return 0


def collect(reader, stamps, clouds, layouts) -> int:
    """Take what has come; how many clouds that makes."""
    for cloud in reader.take(N=10):
        stamp = cloud.header.stamp
        stamps.append((stamp.sec, stamp.nanosec))
        clouds.append(np.frombuffer(bytes(cloud.data), dtype="<f4").reshape(cloud.width, cloud.point_step // 4))
        fields = ",".join(f"{field.name}:{field.offset}:{field.datatype}:{field.count}" for field in cloud.fields)
        layouts.append(f"{cloud.header.frame_id} {cloud.height} {cloud.is_bigendian} {cloud.is_dense} {fields}")
    return len(stamps)


def wait_for(done, what: str) -> None:
    deadline = time.monotonic() + ANSWER_SECONDS
    while not done():
        if time.monotonic() > deadline:
            sys.exit(f"no {what} within {ANSWER_SECONDS:.0f} s")
        time.sleep(0.01)


if __name__ == "__main__":
    sys.exit(main())
