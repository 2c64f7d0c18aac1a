"""What each function of URScript does to what a target means: all of the manual (CB3 3.15, e-Series 5.22), and the only list.

A function that stands here nowhere, and in no given file, may do anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto


@dataclass(frozen=True)
class Move:
    """A function that moves to a place.

    Attributes:
        parameters: In their order.
        goals: Those that say the place.
        by_joints: The arm goes there by its joints, and may change its posture; else on a line in space, and keeps it.
        joints_only: The place is stated in joints.
    """

    parameters: tuple[str, ...]
    goals: tuple[str, ...]
    by_joints: bool = False
    joints_only: bool = False


@dataclass(frozen=True)
class Switch:
    """A function that begins or ends a mode in which the arm does not go where targets say.

    Attributes:
        mode: Its name.
        on: Whether it begins.
        led: Somebody leads the arm by hand meanwhile, or it moves by itself: nobody knows where it stands afterwards.
    """

    mode: str
    on: bool
    led: bool = False


class Rule(Enum):
    """What another function does."""

    HARMLESS = auto()
    """Nothing to frames, tools, modes and points; what it is given goes on to where nobody sees it."""

    LOOKS = auto()
    """The same, and what it is given is only shown or tested."""

    POSTURE = auto()
    """It moves the arm, or counts its turns anew, in a way that changes its posture."""

    TOOL = auto()
    """It sets the tool."""

    OPEN = auto()
    """It carries out what comes from outside."""


VIA = "pose_via"
"""The goal of `movec` of which the position alone is used: "Rotations are not used so can be left as zeros"."""

MODE = "mode"
"""The parameter of `movec` that decides whether the orientation of its end is used."""

MOVES = {
    "movej": Move(("q", "a", "v", "t", "r"), ("q",), by_joints=True),
    "movel": Move(("pose", "a", "v", "t", "r"), ("pose",)),
    "movep": Move(("pose", "a", "v", "r"), ("pose",)),
    "movec": Move((VIA, "pose_to", "a", "v", "r", MODE), (VIA, "pose_to")),
    "optimovej": Move(("target", "a", "v", "r"), ("target",), by_joints=True),
    "optimovel": Move(("target", "a", "v", "r"), ("target",)),
    "servoj": Move(("q", "a", "v", "t", "lookahead_time", "gain"), ("q",), by_joints=True, joints_only=True),
    "servoc": Move(("pose", "a", "v", "r"), ("pose",)),
}

SWITCHES = {
    "force_mode": Switch("force_mode", True),
    "force_mode_example": Switch("force_mode", True),
    "end_force_mode": Switch("force_mode", False),
    "teach_mode": Switch("teach_mode", True, led=True),
    "end_teach_mode": Switch("teach_mode", False, led=True),
    "freedrive_mode": Switch("freedrive_mode", True, led=True),
    "freedrive_mode_no_incorrect_payload_check": Switch("freedrive_mode", True, led=True),
    "end_freedrive_mode": Switch("freedrive_mode", False, led=True),
    "screw_driving": Switch("screw_driving", True),
    "end_screw_driving": Switch("screw_driving", False),
    "track_conveyor_linear": Switch("conveyor tracking", True),
    "track_conveyor_circular": Switch("conveyor tracking", True),
    "stop_conveyor_tracking": Switch("conveyor tracking", False),
    "path_offset_enable": Switch("path offset", True),
    "path_offset_disable": Switch("path offset", False),
}
"""A path offset is set by `path_offset_set`, which does nothing where it is not enabled."""

SWITCHED = tuple(dict.fromkeys(switch.mode for switch in SWITCHES.values()))

_POSTURE = "speedj direct_torque torque_command set_pos reset_revolution_counter"

_LOOKS = """
textmsg popup length get_list_length size is_within_safety_limits get_inverse_kin_has_solution
"""

_HARMLESS = """
conveyor_pulse_decode encoder_enable_pulse_decode encoder_enable_set_tick_count encoder_get_tick_count encoder_set_tick_count
encoder_unwind_delta_tick_count force_mode_set_damping force_mode_set_gain_scaling get_conveyor_tick_count get_freedrive_status
get_target_tcp_pose_along_path get_target_tcp_speed_along_path path_offset_get path_offset_get_offset path_offset_set
path_offset_set_alpha_filter path_offset_set_max_offset pause_on_error_code position_deviation_warning set_conveyor_tick_count
set_safety_mode_transition_hardness speedl stopj stopl
force get_actual_joint_positions get_actual_joint_positions_history get_actual_joint_speeds get_actual_tcp_pose
get_actual_tcp_speed get_actual_tool_flange_pose get_controller_temp get_coriolis_and_centrifugal_torques get_forward_kin
get_jacobian get_jacobian_time_derivative get_joint_temp get_joint_torques get_mass_matrix get_robot_id get_steptime
get_target_joint_accelerations get_target_joint_positions get_target_joint_speeds get_target_payload get_target_payload_cog
get_target_payload_inertia get_target_tcp_pose get_target_tcp_speed get_target_waypoint get_tcp_force
get_tool_accelerometer_reading get_tool_current tool_pose high_holding_torque_disable high_holding_torque_enable is_steady
low_holding_torque_disable low_holding_torque_enable make_list motion_version_set powerdown request_boolean_from_primary_client
request_float_from_primary_client request_integer_from_primary_client request_string_from_primary_client set_baselight_mode
set_baselight_color set_baselight_off set_gravity set_payload set_payload_cog set_payload_mass set_target_payload sleep str_at
str_cat str_empty str_find str_len str_sub struct sync time to_num to_str tool_contact tool_contact_examples
tool_wrench_limit_disable tool_wrench_limit_enable tool_wrench_limit_set
acos asin atan atan2 binary_list_to_integer ceil cos floor integer_to_binary_list interpolate_pose inv log norm normalize
point_dist pose_add pose_dist pose_sub pow random rotvec2rpy rpy2rotvec sin sqrt tan transpose wrench_trans
eip_reader_factory eip_writer_factory enable_external_ft_sensor ft_rtde_input_enable
get_analog_in get_analog_out get_configurable_digital_in
get_configurable_digital_out get_digital_in get_digital_out get_euromap_input get_euromap_output get_flag
get_standard_analog_in get_standard_analog_out get_standard_digital_in get_standard_digital_out get_tool_analog_in
get_tool_digital_in get_tool_digital_out modbus_add_rtu_signal modbus_add_signal modbus_delete_signal
modbus_get_error_count modbus_get_signal_status modbus_get_time_since_signal_invalid modbus_request_update_signal
modbus_reset_connection modbus_send_custom_command modbus_set_digital_input_action modbus_set_output_register
modbus_set_output_signal modbus_set_runstate_dependent_choice modbus_set_signal_update_frequency modbus_set_signal_watchdog
read_input_boolean_register read_input_float_register read_input_integer_register read_output_boolean_register
read_output_float_register read_output_integer_register read_port_bit read_port_register rpc_factory rtde_set_watchdog
set_analog_inputrange set_analog_out set_analog_outputdomain set_configurable_digital_input_action set_configurable_digital_out
set_digital_out set_euromap_output set_euromap_runstate_dependent_choice set_flag set_gp_boolean_input_action
set_input_actions_to_default set_output_runstate_choice set_runstate_configurable_digital_output_to_value
set_runstate_gp_boolean_output_to_value set_runstate_configurable_digital_outputs set_runstate_standard_digital_outputs
set_runstate_tool_digital_outputs set_runstate_standard_analog_output_to_value
set_runstate_standard_digital_output_to_value set_runstate_tool_digital_output_to_value set_standard_analog_input_domain
set_standard_analog_out set_standard_digital_input_action set_standard_digital_out set_tool_analog_input_domain
set_tool_communication set_tool_digital_input_action set_tool_digital_out set_tool_digital_output_mode set_tool_output_mode
set_tool_voltage set_watchdog socket_close socket_get_var socket_open socket_read_ascii_float socket_read_binary_integer
socket_read_byte_list socket_read_line socket_read_string socket_send_byte socket_send_int socket_send_line
socket_send_string socket_set_var write_output_boolean_register write_output_float_register write_output_integer_register
write_port_bit write_port_register zero_ftsensor
"""

EVALUATED = ("pose_trans", "pose_inv", "get_inverse_kin", "get_tcp_offset", "d2r", "r2d")
"""Functions of which the value is worked out here, where it is certain."""

RULES: dict[str, Move | Switch | Rule] = {
    **MOVES,
    **SWITCHES,
    **dict.fromkeys(_POSTURE.split(), Rule.POSTURE),
    **dict.fromkeys(_LOOKS.split(), Rule.LOOKS),
    **dict.fromkeys((*_HARMLESS.split(), *EVALUATED), Rule.HARMLESS),
    "set_tcp": Rule.TOOL,
    "interpreter_mode": Rule.OPEN,
}
"""By the name of each function."""
