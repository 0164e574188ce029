"""Algorithm 8.1 on a ship whose sway and yaw close the loop: the load by a rudder's reference."""
