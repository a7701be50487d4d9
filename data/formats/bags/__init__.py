"""ROS bags with detections, fixes, truth or scans as logs."""
