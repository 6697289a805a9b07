"""Start the identification node beside a running robot; with ``rviz:=true`` RViz, with ``urdf:=`` a robot to show."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import Command, LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "config": ("geomid.yaml", "One of the files in the package's config folder."),
    "namespace": ("", "Namespace of the node, in that of the launch file that includes this one."),
    "use_sim_time": ("false", "Follow /clock."),
    "joint_states": ("joint_states", "Topic of the joints' states."),
    "odom": ("odom", "Topic of a floating base's pose."),
    "urdf": ("", "URDF or xacro for robot_state_publisher, where none runs yet."),
    "rviz": ("false", "Start RViz with the robot and what is identified of it."),
    "fixed_frame": ("base_link", "The robot's base, for RViz."),
}


def in_config(name: object) -> PathJoinSubstitution:
    return PathJoinSubstitution([FindPackageShare("geomid_ros"), "config", name])


def generate_launch_description() -> LaunchDescription:
    namespace, joint_states = LaunchConfiguration("namespace"), LaunchConfiguration("joint_states")
    sim_time = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    urdf = LaunchConfiguration("urdf")
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=in_config(LaunchConfiguration("config")),
                description="Parameters of the node, instead of those of config.",
            ),
            Node(
                package="geomid_ros",
                executable="geomid_node",
                namespace=namespace,
                parameters=[LaunchConfiguration("params_file"), sim_time],
                remappings=[("joint_states", joint_states), ("odom", LaunchConfiguration("odom"))],
                output="screen",
            ),
            Node(
                condition=IfCondition(NotEqualsSubstitution(urdf, "")),
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=namespace,
                parameters=[{"robot_description": ParameterValue(Command(["xacro ", urdf]), value_type=str)}, sim_time],
                remappings=[("joint_states", joint_states)],
            ),
            Node(
                condition=IfCondition(LaunchConfiguration("rviz")),
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", in_config("geomid.rviz"), "--fixed-frame", LaunchConfiguration("fixed_frame")],
                parameters=[sim_time],
                # The file has them in no namespace; so they are in this one.
                remappings=[
                    (f"/{topic}", topic)
                    for topic in ("robot_description", "geomid/robot_description", "geomid/markers")
                ],
            ),
        ]
    )
