./tissue run heart &
.venv/bin/python -m tool_input.crtk_node --ros-args -p arm:=PSM1 -p tool:=grasper \
  -p base_position:="[0.035, 0.012, -0.007]" -p scale:=0.5
