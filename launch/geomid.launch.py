"""Start the identification node beside a running robot; with ``rviz:=true`` RViz, with ``urdf:=`` a robot to show."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import Command, LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def in_config(name: object) -> PathJoinSubstitution:
    return PathJoinSubstitution([FindPackageShare("geomid_ros"), "config", name])


def given(context: LaunchContext, name: str) -> list[dict[str, LaunchConfiguration]]:
    """The argument as a parameter, if it is given: what stands behind the parameter file overrides it."""
    return [{name: LaunchConfiguration(name)}] if context.launch_configurations[name] else []


def start(context: LaunchContext) -> list[Node]:
    namespace, joint_states = LaunchConfiguration("namespace"), LaunchConfiguration("joint_states")
    urdf, sim_time = LaunchConfiguration("urdf"), given(context, "use_sim_time")
    return [
        Node(
            package="geomid_ros",
            executable="geomid_node",
            namespace=namespace,
            parameters=[LaunchConfiguration("params_file"), *sim_time, *given(context, "lifecycle")],
            remappings=[
                ("joint_states", joint_states),
                ("odom", LaunchConfiguration("odom")),
                ("imu", LaunchConfiguration("imu")),
                ("joint_commands", LaunchConfiguration("joint_commands")),
            ],
            output="screen",
        ),
        Node(
            condition=IfCondition(NotEqualsSubstitution(urdf, "")),
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[
                {"robot_description": ParameterValue(Command(["xacro '", urdf, "'"]), value_type=str)},
                *sim_time,
            ],
            remappings=[("joint_states", joint_states)],
        ),
        Node(
            condition=IfCondition(LaunchConfiguration("rviz")),
            package="rviz2",
            executable="rviz2",
            namespace=namespace,
            arguments=["-d", in_config("geomid.rviz"), "--fixed-frame", LaunchConfiguration("fixed_frame")],
            parameters=sim_time,
            # The file has them in no namespace; so they are in this one.
            remappings=[
                (f"/{topic}", topic) for topic in ("robot_description", "geomid/robot_description", "geomid/markers")
            ],
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config", default_value="geomid.yaml", description="One of the files in the package's config folder."
            ),
            DeclareLaunchArgument(
                "namespace",
                default_value="",
                description="Namespace of the node, in that of the launch file that includes this one.",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="", description="Follow /clock; empty: as in params_file."
            ),
            DeclareLaunchArgument(
                "joint_states", default_value="joint_states", description="Topic of the joints' states."
            ),
            DeclareLaunchArgument("odom", default_value="odom", description="Topic of a floating base's pose."),
            DeclareLaunchArgument(
                "joint_commands", default_value="joint_commands", description="Topic of set-points, with command.gains."
            ),
            DeclareLaunchArgument("imu", default_value="imu", description="Topic of an IMU on a moving base."),
            DeclareLaunchArgument(
                "urdf", default_value="", description="URDF or xacro for robot_state_publisher, where none runs yet."
            ),
            DeclareLaunchArgument(
                "rviz", default_value="false", description="Start RViz with the robot and what is identified of it."
            ),
            DeclareLaunchArgument(
                "lifecycle",
                default_value="",
                description="managed: a lifecycle node; autostart: one that configures and activates itself; none; "
                "empty: as in params_file.",
            ),
            DeclareLaunchArgument("fixed_frame", default_value="base_link", description="The robot's base, for RViz."),
            DeclareLaunchArgument(
                "params_file",
                default_value=in_config(LaunchConfiguration("config")),
                description="Parameters of the node, instead of those of config.",
            ),
            OpaqueFunction(function=start),
        ]
    )
