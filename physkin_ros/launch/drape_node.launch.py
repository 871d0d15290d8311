"""`ros2 launch physkin_ros drape_node.launch.py config:=/path/to/avatars.yaml`"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("physkin_ros")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([share, "config", "one_avatar.yaml"]),
                description="ROS 2 parameter file of the drape node",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of the drape node"),
            # 32 MB of shared memory: with Fast DDS's default of 512 KB, a few garments at once lose clouds
            SetEnvironmentVariable(
                "FASTRTPS_DEFAULT_PROFILES_FILE", PathJoinSubstitution([share, "config", "fastdds.xml"])
            ),
            LifecycleNode(
                package="physkin_ros",
                executable="drape_node",
                name="drape_node",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("config")],
                output="screen",
                respawn=True,
                respawn_delay=1.0,
            ),
        ]
    )
