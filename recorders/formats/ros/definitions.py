"""Public definitions of the ROS 2 messages that bags tell poses with, beyond those of our logs."""

from __future__ import annotations

_LINE = "=" * 80
_HEADER = f"""
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_POSE = f"""
{_LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""

POSE_DEFINITIONS = {
    "geometry_msgs/msg/PoseStamped": f"""std_msgs/Header header
geometry_msgs/Pose pose
{_HEADER}{_POSE}""",
    "nav_msgs/msg/Odometry": f"""std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
{_HEADER}{_POSE}{_LINE}
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
{_LINE}
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
{_LINE}
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
""",
}
"""Message definitions by type name."""
