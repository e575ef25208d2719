./tissue run heart &
ros2 run spacenav spacenav_node &
.venv/bin/python -m tool_input.joy_node --ros-args -p tools:="['grasper', 'scalpel']" \
  -p motion:=twist -p twist_topic:=spacenav/twist -p joy_topic:=spacenav/joy \
  -p use_mode:=toggle -p clutch_button:=-1 -p slow_button:=-1 -p home_button:=-1
