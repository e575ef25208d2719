ros2 topic pub --rate 125 --times 500 /tools/grasper/servo_cp geometry_msgs/msg/PoseStamped \
  '{header: {stamp: now, frame_id: organ}, pose: {position: {x: 0.035, y: 0.012, z: -0.007}}}' &
ros2 topic pub --once /tools/grasper/use std_msgs/msg/Bool '{data: false}'
ros2 topic pub --once /tools/grasper/use std_msgs/msg/Bool '{data: true}'
