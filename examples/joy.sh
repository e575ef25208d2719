./tissue run heart &
ros2 run joy joy_node &
.venv/bin/python -m tool_input.joy_node --ros-args -p tools:="['grasper', 'scalpel']" \
  -p linear_scale:=0.03 -p exponent:=2.0
