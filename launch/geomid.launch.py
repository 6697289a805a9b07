"""Start the identification node beside a running robot."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config", default_value="geomid.yaml", description="One of the files in the package's config folder."
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution(
                    [FindPackageShare("geomid_ros"), "config", LaunchConfiguration("config")]
                ),
                description="Parameters of the node, instead of those of config.",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node."),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Follow /clock."),
            DeclareLaunchArgument(
                "joint_states", default_value="joint_states", description="Topic of the joints' states."
            ),
            DeclareLaunchArgument("odom", default_value="odom", description="Topic of a floating base's pose."),
            Node(
                package="geomid_ros",
                executable="geomid_node",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"use_sim_time": LaunchConfiguration("use_sim_time")},
                ],
                remappings=[
                    ("joint_states", LaunchConfiguration("joint_states")),
                    ("odom", LaunchConfiguration("odom")),
                ],
                output="screen",
            ),
        ]
    )
