"""What statements, system variables and standard routines of KRL do.

BAS, the functions of inline forms and IR_STOPM are as in KUKA's modules `bas.src` and `ir_stopm.src` of KSS 8. The other rows are
after common knowledge of KRL, and remain to be compared with the manual, row by row.

What is in none of these tables is unknown: behind it nothing is certain that it may touch.
"""

from __future__ import annotations


def _words(text: str) -> frozenset[str]:
    """The words of a text, of many that need no quotes each."""
    return frozenset(text.split())


LINEAR = frozenset(("lin", "slin", "circ", "scirc", "spl"))
"""Moves along a path: the arm keeps its posture."""

JOINTED = frozenset(("ptp", "sptp"))
"""Moves of all axes at once: S and T of the target, or those from before, say the posture."""

CIRCULAR = frozenset(("circ", "scirc"))
"""Moves by way of an auxiliary point."""

RELATIVE = frozenset(f"{word}_rel" for word in LINEAR | JOINTED)
"""Steps from the place before: their numbers are no place."""

ASYNCHRONOUS = frozenset(("asyptp", "asycont", "asystop", "asycancel"))
"""Moves of external axes that the program does not wait for."""

FORMS = frozenset(("fdat", "ldat", "pdat"))
"""Types of what inline forms say besides the place."""

APPROXIMATIONS = frozenset(("c_ptp", "c_dis", "c_ori", "c_vel", "c_spl"))
"""How a target is rounded: it means the same place."""

HARMLESS = frozenset(
    (
        "wait",  # FOR, SEC
        "halt",
        "continue",  # no stop of the advance run
        "brake",  # in interrupt routines: the arm stops, and goes on
        "on_error_proceed",
        "confirm",
        "stop",  # STOP WHEN PATH, a conditional stop in a spline
        "const_vel",  # ranges of a spline
        "time_block",
    )
)
"""Statements that change nothing of frames, tools, modes, points and the way that the program takes."""

DECLARATIONS = frozenset(("signal", "struc", "enum", "channel", "ext", "extp", "extfct", "extfctp", "import"))
"""Statements that declare what holds no place, besides DECL and the types themselves."""

TYPES = frozenset(
    ("int", "real", "bool", "char", "pos", "e6pos", "frame", "axis", "e6axis", "load", "inertia", "state_t")
)
"""Types whose declarations need no DECL."""

POINTS = frozenset(("pos", "e6pos", "axis", "e6axis"))
"""Types of what moves go to."""

HELD = {
    "$axis_act",
    "$axis_act_meas",
    "$axis_act_mes",
    "$pos_act",
    "$pos_act_mes",
}
"""Places where the arm is already: a move there is none."""

SYSTEM_VARIABLES = frozenset(
    f"${name}"
    for name in _words(
        # speeds, accelerations, approximation, and what else is of the way between targets
        "acc acc_axis acc_c acc_extax acc_ma advance apo apo_dis_ptp bwdstart circ_mode circ_type "
        "cp_vel_type filter gear_jerk jerk jerk_ma ori_type ov_appl ov_jog ov_pro ov_rob "
        "red_vel spl_tsys vel vel_axis vel_c vel_extax vel_ma spl_ori_joint_auto "
        "singul_strategy singul_dist "
        # numbers of tool and base for the display, and loads
        "act_base act_base_c act_tool act_tool_c act_ex_ax load load_c load_a1 load_a2 load_a3 load_a1_c "
        "load_a2_c load_a3_c "
        # signals, flags, timers
        "out out_c anout flag cycflag timer timer_stop sen_pint sen_prea "
        "h_pos h_pos_tol h_axis_tol "
        # monitoring, messages, program run
        "torqmon torqmon_com torqmon_def torqmon_com_def torqmon_time coll_alarm coll_enable coll_on "
        "tol_vel soft_plc_cmd pro_mode pro_mode1 loop_msg loop_cont cycle_time err wboxdisable workspace "
        "axworkspace softn_end softp_end "
        "collmon_on coll_load coll_targetload "
        "act_group gear_jerk_ma torq_diff torq_diff2 "
        "collmon_tol_pro "
    )
)
"""Variables of the controller to which a program may give values without another meaning of its targets."""

FRAMES_OF_ALL = {"$nullframe", "$world"}
"""Frames that say no transform."""

OUTSIDE = frozenset(("$ex_ax_ignore",))
"""Variables that concern external axes alone."""

ODD = {
    "rsi_on": "a sensor moves the arm besides",
    "rsi_movecorr": "a sensor moves the arm besides",
    "st_on": "a sensor moves the arm besides",
    "st_on1": "a sensor moves the arm besides",
    "st_on2": "a sensor moves the arm besides",
}
"""Routines after which the arm is elsewhere than targets say."""

FUNCTIONS = _words(
    "abs sqrt sin cos tan acos atan2 varstate strlen strdecllen strfind strcomp "
    "sync set_krlmsg set_krldlg exists_krlmsg "
    "exists_krldlg clear_krlmsg clear_krldlg pulse cwrite swrite cclose cioctl "
    "msgnotify msgquit msgdialog msgloop "
    "svel_cp svel_joint sacc_cp sacc_joint sapo sapo_ptp sload sgear_jerk sjerk scirc_typ scirc_m sori_typ sipo_mode "
    "s_exax_ign s_exax_ign2 use_cm_pro_values stool stool2 sbase k_root k_type k_offs k_addr k_name k_shift ek eb lk inv_pos "
    "err_clear err_raise eki_init eki_open eki_close eki_clear eki_send eki_checkbuffer eki_lock eki_unlock "
    "eki_setint eki_setreal eki_setbool eki_setstring eki_setframe eki_clearbuffer "
    "set_tq_values tqm_fifo_read set_cd_params "
    "arcgetdelay arcgetpath "
    "ac_pointarrival st_off rsi_off rsi_delete "
    # messages, start-up and program numbers of the modules that controllers come with
    "ir_stopm p00 "
)
"""Functions and routines of the controller that read what they are given, and change nothing that matters here."""

WRITING = _words(
    "strtoint strtoreal strtobool strcopy stradd strclear "
    "cread sread copen cast_to cast_from eki_getint eki_getreal eki_getbool "
    "eki_getstring eki_getframe eki_getintarray eki_getrealarray eki_getboolarray eki_getframearray"
)
"""Likewise, and they write into what they are given."""

PACKAGES = _words("h50 h70 user_grp userspot grpg_check grpg_setstateandcheck arcmainng")
"""Routines of KUKA's grippers, spot guns and arc welding: they switch signals, wait, and weave to and fro about the path. A note
says that this is taken for granted."""

SYSTEM_MODULES = frozenset(
    ("bas", "ir_stopm", "p00", "msglib", "h50", "h70", "masref_main", "tm_bib", "new_serv", "ibgn", "bas_t")
)
"""Modules that controllers come with: these tables say what they do, their text is not read."""

BAS_HARMLESS = frozenset(
    (
        "#acc_cp",
        "#acc_glue",
        "#acc_ptp",
        "#vel_cp",
        "#vel_ptp",
        "#cp_dat",
        "#ptp_dat",
        "#out_sync",
        "#out_async",
        "#group",
    )
)
"""Commands of BAS on speeds, accelerations and signals."""

BAS_FRAMES = frozenset(("#frames", "#ptp_params", "#cp_params"))
"""Commands of BAS that set tool, base and mode from FDAT_ACT."""

CORRECTIONS = frozenset(
    (
        "base_corr",
        "base_corr_on",
        "m_base_corr",
        "m_bas_cor_on",
        "tool_corr",
        "tool_corr_on",
        "tool_corr_w",
        "tool_corr_w_on",
    )
)
"""Variables by which BAS and the functions of inline forms shift numbered tools and bases."""
