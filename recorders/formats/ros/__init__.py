"""ROS bags: topics, messages and transforms."""
