"""What each instruction and function of RAPID does to places, frames, tools, modes and data.

After ABB's technical reference of instructions, functions and data types (RobotWare 5 to 7), and the application manuals of its
options. A name that stands nowhere here, and that no given module declares, is a routine that is not known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


def _names(text: str) -> frozenset[str]:
    return frozenset(text.lower().split())


Way = Literal["L", "J", "A", "E"]


@dataclass(frozen=True)
class Move:
    """A move, by the place of its arguments among those that must stand there.

    Attributes:
        points: Where it goes, from 0; a point on a circle before its end.
        tool: Its tool, -1 for the last; None where it has none.
        way: ``L`` and ``J``: the arm's configuration is that of confdata where `ConfL` and `ConfJ` ask for it; ``A``: axes of
            the arm; ``E``: external axes alone.
        written: Arguments that it writes.
        routine: The argument that names a procedure to be called; None where there is none.
        why: Why its numbers are not the place that is reached; empty if they are.
    """

    points: tuple[int, ...]
    tool: int | None
    way: Way
    written: tuple[int, ...] = ()
    routine: int | None = None
    why: str = ""


_L, _J, _C, _A = Move((0,), 3, "L"), Move((0,), 3, "J"), Move((0, 1), 4, "L"), Move((0,), 3, "A")

_TRIGG = {
    "triggl": Move((0,), 4, "L"),
    "triggj": Move((0,), 4, "J"),
    "triggc": Move((0, 1), 5, "L"),
    "triggabsj": Move((0,), 4, "A"),
    "trigglios": _L,
    "triggjios": _J,
}

_PROCESS = {
    prefix + letters + suffix: Move((0, 1) if letters == "c" else (0,), -1, "J" if letters == "j" else "L")
    for prefix, every, suffixes in (
        ("arc", "lc", ("", "start", "end", "1", "2", "1start", "2start", "1end", "2end")),
        ("arcmove", "ljc", ("",)),
        ("arcrefill", "lc", ("",)),
        ("spot", "lj", ("",)),
        ("spotm", "lj", ("",)),
        ("nut", "lj", ("",)),
        ("paint", "lc", ("",)),
        ("disp", "ljc", ("",)),
        ("cap", "lc", ("",)),
        ("laser", "lc", ("", "start", "end")),
        ("cut", "lc", ("", "start", "end")),
    )
    for letters in every
    for suffix in suffixes
}

FORCE = "a force decides where the arm goes"

SENSOR = "a sensor corrects where the arm goes"

MOVES: dict[str, Move] = {
    "movel": _L,
    "movej": _J,
    "movec": _C,
    "moveabsj": _A,
    "moveextj": Move((0,), None, "E"),
    **{f"move{how}{what}": move for how, move in (("l", _L), ("j", _J), ("c", _C)) for what in ("do", "ao", "go")},
    "movelsync": Move((0,), 3, "L", routine=4),
    "movejsync": Move((0,), 3, "J", routine=4),
    "movecsync": Move((0, 1), 4, "L", routine=5),
    **_TRIGG,
    "searchl": Move((2,), 4, "L", written=(1,)),
    "searchj": Move((2,), 4, "J", written=(1,)),
    "searchc": Move((2, 3), 5, "L", written=(1,)),
    "searchextj": Move((2,), None, "E", written=(1,)),
    **_PROCESS,
    "arcmoveabsj": Move((0,), -1, "A"),
    "arcmoveextj": Move((0,), None, "E"),
    "egmmovel": Move((1,), -1, "L", why=SENSOR),
    "egmmovec": Move((1, 2), -1, "L", why=SENSOR),
    "contactl": Move((0,), -1, "L", why=FORCE),
    "fcpressl": Move((0,), -1, "L", why=FORCE),
    "fcpressc": Move((0, 1), -1, "L", why=FORCE),
    "fcpressend": Move((0,), -1, "L", why=FORCE),
    "fcpress1lstart": Move((0,), -1, "L", why=FORCE),
}
"""Moves. Of a process's moves the tool is the last argument in all versions."""

PLAIN_OPTIONS = _names(
    "conc id v t z inpos wobj tload noeoffs useeoffs stop pstop sstop sup flanks posflank negflank highlevel lowlevel weave "
    "start on off t2 t3 t4 t5 t6 t7 t8 triggdata1 triggdata2 triggdata3 time timer do1 checkinpos noconc inpos1 seamname "
    "advrec preprocesstracking postprocesstracking movestarttimer dipswitch hold finisht"
)
"""Optional arguments of moves that leave the place as it is. The others, `Corr` and `Track` first, correct it by a sensor, or are
not known."""

MODES: dict[str, tuple[str, str]] = {
    "pdispon": ("displacement", "line"),
    "pdispadd": ("displacement", "line"),
    "pdispset": ("displacement", "argument"),
    "pdispoff": ("displacement", "default"),
    "eoffson": ("offset", "line"),
    "eoffsset": ("offset", "line"),
    "eoffsoff": ("offset", "default"),
    "confl": ("confl", "switch"),
    "confj": ("confj", "switch"),
    "singarea": ("wrist", "switch"),
    "softact": ("softness", "line"),
    "softdeact": ("softness", "default"),
    "indamove": ("independence", "line"),
    "indcmove": ("independence", "line"),
    "inddmove": ("independence", "line"),
    "indrmove": ("independence", "line"),
    "indreset": ("independence", "line"),
    "fcact": ("force", "line"),
    "fcdeact": ("force", "default"),
    "actunit": ("units", "line"),
    "deactunit": ("units", "line"),
}
"""Instructions that change how all later moves are meant: which mode, and to what. ``line``: to what no plain numbers say;
``switch``: their optional argument says it."""

DEFAULTS: dict[str, object] = {
    "displacement": None,
    "offset": None,
    "confl": "on",
    "confj": "on",
    "wrist": "off",
    "softness": None,
    "independence": None,
    "force": None,
    "units": None,
}
"""Modes at a program's start."""

WHY = {
    "displacement": "moves the frame of targets",
    "offset": "moves the external axes",
    "confl": "may let confdata count or not",
    "confj": "may let confdata count or not",
    "wrist": "may turn the tool otherwise than targets say",
    "softness": "makes an axis soft",
    "independence": "lets an axis turn by itself",
    "force": "lets a force decide where the arm goes",
    "units": "switches external axes",
}
"""What such an instruction does to targets, for messages."""

IN_THE_WAY = ("offset", "softness", "independence", "force")
"""Modes that leave all targets as they are while they are on."""

UNSTEADY = _names(
    "egmrunjoint egmrunpose egmrunmove pathrecmovebwd pathrecmovefwd stepbwdpath setleadthrough hollowwristreset fcrefstart "
    "fcpresslstart search_1d search_groove search_part paramident loadid manloadidproc loadidentify"
)
"""Instructions behind which nobody knows where the arm stands."""

WILD = _names(
    "setdataval setalldataval load startload waitload unload erasemodule writecfgdata loadcfgdata savecfgdata warmstart "
    "callbyvar"
)
"""Instructions that may change data and modes of any module."""

READING = _names(
    """
    accset acteventbuffer addaccessrule aliascamera arckill arcrefresh arcmanual bealignaxis bookerrno break camflush
    camloadjob camreqimage camsetexposure camsetparameter camsetprogrammode camsetrunmode camstartloadjob camwaitloadjob
    cancelload checkprogref cirpathmode clearpath clkreset clkstart clkstop close closedir comment copyfile corrclear
    corrdiscon deacteventbuffer ditheract ditherdeact dropsensor egmactjoint egmactmove egmactpose egmreset egmsetupai
    egmsetupao egmsetupgi egmsetupltapp egmsetupuc egmstop egmstreamstart egmstreamstop errlog errraise errwrite fccalib
    fcloadid fcresetlpfiltertune fcsetlpfiltertune fcspdchgact fcspdchgdeact fcspdchgtune fcsetdampingtune
    fcresetdampingtune fcsupcartspeed fcsupforce fcsuporient fcsuppos fcsupreoriespeed fcsuptcpspeed fcsuptorque
    fccondforce fccondorient fccondpos fccondreoriespeed fccondtcpspeed fccondtorque fccondwaitwhile fcrefcircle
    fcrefforce fcrefline fcrefmoveframe fcrefrot fcrefspiral fcrefstop fcreftorque fcdeactivatelogging fricidevaluate
    fricidinit fricidsetfriclevels gripload icap idelete idisable ienable ierror invertdo iobusstart iobusstate
    iodisable ioenable ipers irmqmessage isignalai isignalao isignaldi isignaldo isignalgi isignalgo isleep itimer
    ivarvalue iwatch logout makedir mechunitload motionprocessmodeset motionsup open opendir packdnheader pathacclim
    pathrecstart pathrecstop pathresol perfmonstart perfmonstop proccall procerrrecovery pulsedo raisetouser
    removeallcyclicbool removecyclicbool removedir removefile renamefile reset resetaxisdistance resetaxismovetime
    resetppmoved resetretrycount restopath rewind rmqemptyqueue rmqsendmessage save scwrite sendevice set setao
    setdatasearch setdo setgo setsysdata setupcyclicbool skipwarn smbmsg socketaccept socketbind socketclose
    socketconnect socketcreate socketlisten socketsend socketsendto speedlimaxis speedlimcheckpoint speedrefresh
    spystart spystop startmove startmoveretry stcalib stclose stindgun stindgunreset stop stopen stopmove stopmovereset
    storepath sttune sttunereset supsyncsensoroff supsyncsensoron syncmoveoff syncmoveon syncmoveresume syncmovesuspend
    syncmoveundo synctosensor systemstopaction testsigndefine testsignreset texttabinstall tperase tpshow tpwrite
    traceon traceoff triggcheckio triggdatareset triggequip triggint triggio triggrampao triggspeed triggstopproc
    tunereset tuneservo uimsgbox uimsgwrite uimsgwriteabort uishow velset waitai waitao waitdi waitdo waitgi waitgo
    waitrob waitsensor waitsynctask waittime waituntil worldacclim write writeanybin writebin writeblock writerawbytes
    writestrbin writevar writevararr wzboxdef wzcyldef wzdisable wzdoset wzenable wzfree wzhomejointdef wzlimjointdef
    wzlimsup wzsphdef xmlclose g_init g_calibrate g_gripin g_gripout g_moveto g_stop g_jogin g_jogout g_setforce
    g_setmaxspd g_vacuumon1 g_vacuumon2 g_vacuumoff1 g_vacuumoff2 g_blowon1 g_blowon2 g_blowoff1 g_blowoff2
    hand_initialize hand_docalibration hand_gripinward hand_gripoutward hand_jogin hand_jogout hand_jogstop hand_moveto
    hand_sethelpspeed hand_setholdforce hand_setmaxspeed hand_stop hand_turnoffblow1 hand_turnoffblow2
    hand_turnoffvacuum1 hand_turnoffvacuum2 hand_turnonblow1 hand_turnonblow2 hand_turnonvacuum1 hand_turnonvacuum2
    """
)
"""Instructions that read their arguments, and change nothing that a target's meaning depends on: signals, waiting, speeds, loads,
interrupts, files, messages, supervision."""

WRITING = _names(
    """
    add aliasio aliasioreset bitclear bitset camgetparameter camgetresult clear cleariobuff clearrawbytes clkread
    copyrawbytes corrcon corrwrite decr dropwobj egmgetid fcgetforce getdataval getjointdata getsysdata gettrapdata
    gettorque incr mtoolrotcalib mtooltcpcalib packrawbytes readanybin readblock readcfgdata readerrdata readrawbytes
    readvararr recordprofile rmqfindslot rmqgetmessage rmqgetmsgdata rmqgetmsgheader rmqreadwait rmqsendwait
    socketreceive socketreceivefrom stoolrotcalib stooltcpcalib swap tpreaddnum tpreadfk tpreadnum triggdatacopy tryint
    unpackrawbytes waittestandset waitwobj xmlgetattribute besetuptoolj betcpextend bequickcheck berefpointer
    oframechange hexapodcalib search_1d search_groove search_part loadid manloadidproc
    """
)
"""Instructions that may write their arguments, and nothing else."""

FUNCTIONS = _names(
    """
    abs absdnum acos acosdnum aoutput ainput argname asin asindnum atan atandnum atan2 atan2dnum bitand bitanddnum
    bitcheck bitcheckdnum bitlsh bitlshdnum bitneg bitnegdnum bitor bitordnum bitrsh bitrshdnum bitxor bitxordnum
    bytetostr calcjointt calcrobt calcrotaxframez calcrotaxisframe camgetexposure camgetloadedjob camgetname camgetmode
    camnumberofresults cdate cjointt clkread corread cos cosdnum cpos crobt cspeedoverride ctime ctool cwobj dectohex
    defaccframe defdframe defframe dim distance dnumtonum dnumtostr dotprod doutput dinput egmgetstate errtext eulerzyx
    eventtype exechandler execlevel exp fcgetforce fcgetprocessdata fcisforcemode fcistrackmode filesize filesizednum
    filetime filetimednum fssize getaxisdistance getaxismovetime getmaxnumberofcyclicbool getmecunitname
    getmodalpayloadmode getmotorcurrent getmotortorque getnextsym getnextmechunit getnextcyclicbool
    getnumberofcyclicbool getserviceinfo getsignalorigin getsysinfo gettaskname gettime gettsindex getuasuserinfo ginput
    ginputdnum goutput goutputdnum hextodec indinpos indspeed iounitstate isbrakecheckactive iscollfree iscyclicbool
    isfile ismechunitactive ispers isstopmoveact isstopstateevent issyncmoveon issysid isvar isleadthrough
    maxextlinearspeed maxextreorientspeed maxextspeed maxextjointspeed maxrobreorientspeed maxrobspeed mirpos modexist
    modtime modtimednum motionplannerno nonmotionmode norient numtodnum numtostr offs opmode orientzyx orobt
    pardidposvalid paridposvalid paridrobvalid pathlengthget pathlevel pathrecvalidbwd pathrecvalidfwd pfrestart poseinv
    posemult posevect pow powdnum ppmovedinmanmode present profileactive progmemfree prxgetmaxrecordpos rawbyteslen
    readbin readdir readmotor readnum readstr readstrbin readvar reltool remainingretries rmqgetslotname robname robos
    round rounddnum runmode safetycontrollergetchecksum safetycontrollergetopmodepinstatus safetycontrollergetswversion
    sin sindnum socketgetstatus socketpeek sqrt sqrtdnum stcalcforce stcalctorque stiscalib stisclosed stisindgun
    stisopen strdigcalc strdigcmp strfind strformat strlen strmap strmatch strmemb strorder strpart strtobyte strtoval
    tan tandnum tasksinsync taskisactive taskisexecuting taskrunmec taskrunrob testandset testdi testsignread textget
    texttabfreetouse texttabget triggdatavalid trunc truncdnum type typeof uialphaentry uiclientexist uidnumentry
    uidnumtune uilistview uimessagebox uinumentry uinumtune unitstate validio valtostr vectmagn wristop
    hand_getactualpos hand_getbyte hand_iscalibrated hand_getpressure1 hand_getpressure2 hand_getspeed g_getpos g_getspd
    g_getpressure1 g_getpressure2 g_getstate g_iscalibrated bectcp
    """
)
"""Functions that change nothing but arguments of those in :data:`WRITING_FUNCTIONS`."""

WRITING_FUNCTIONS = _names("strtoval testandset getnextsym getnextmechunit getnextcyclicbool corread clkread readvar")
"""Functions that may write their arguments."""

FRAME_TYPES: dict[str, tuple[tuple[str, str], ...]] = {
    "pos": (("x", "num"), ("y", "num"), ("z", "num")),
    "orient": (("q1", "num"), ("q2", "num"), ("q3", "num"), ("q4", "num")),
    "pose": (("trans", "pos"), ("rot", "orient")),
    "tooldata": (("robhold", "bool"), ("tframe", "pose"), ("tload", "loaddata")),
    "loaddata": (
        ("mass", "num"),
        ("cog", "pos"),
        ("aom", "orient"),
        ("ix", "num"),
        ("iy", "num"),
        ("iz", "num"),
    ),
    "wobjdata": (
        ("robhold", "bool"),
        ("ufprog", "bool"),
        ("ufmec", "string"),
        ("uframe", "pose"),
        ("oframe", "pose"),
    ),
}
"""Records of frames, with their components."""
