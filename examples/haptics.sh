./tissue run heart &
.venv/bin/python -m tool_input.haptic_node --ros-args -p arm:=MTML -p tool:=grasper \
  -p scale:=0.5 -p force_scale:=2.0 -p max_force:=3.0 -p enable_topic:=footpedals/enable
