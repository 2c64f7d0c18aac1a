"""G-code: words of FANUC's, Siemens', Haas', Okuma's and LinuxCNC's manuals that change what axis words mean."""

from __future__ import annotations

from collections.abc import Sequence

from program_twins import twins

from program_attacks import Attack

FRAMES = """format: 1
bases:
  G54: {xyz: [0.05, -0.1, 0.02], rpy: [0, 0, 0]}
  G55: {xyz: [-0.12, 0.2, 0.0], rpy: [0, 0, 0]}
  G59: {xyz: [0.0, 0.03, -0.04], rpy: [0, 0, 0]}
"""

HEAD = "G21 G17 G40 G49 G80 G90 G94\nG54\nG1 ⟨X10.0 Y20.0 Z5.0⟩ F500\n"

MOVE = "G1 ⟦X30.0 Y40.0 Z6.0⟧ F500"


def body(name: str, text: str, trap: str | tuple[str, ...], plain: str | tuple[str, ...] = "") -> tuple[Attack, Attack]:
    """Blocks behind the first move."""
    return twins(name, {"p.nc": f"{HEAD}{text}\nM30\n"}, trap, plain, FRAMES)


def lone(name: str, trap: str, plain: str = "") -> tuple[Attack, Attack]:
    """A block between two moves."""
    return body(name, f"§\n{MOVE}", trap, plain)


STATE = (
    *lone("a local zero", "G52 X5.0", "G4 P0.5"),
    *lone("a zero set by where the axes are", "G92 X0 Y0", "G92.1"),
    *lone("a zero that is kept from before", "G92.3", "G92.1"),
    *lone("a work offset is written", "G10 L2 P1 X5.0", "S12000 M3"),
    *lone("a work offset is written by where the axes are", "G10 L20 P1 X0 Y0", "M8"),
    *lone("the work offset in force is written", "G10 L2 P0 Z-1.0", "M9"),
    *lone("a turn of the plane", "G68 X0 Y0 R30.0", "G69"),
    *lone("a scale by FANUC", "G51 X0 Y0 Z0 P2000", "M5"),
    *lone("a mirror by FANUC", "G51.1 X0", "M1"),
    *lone("a mirror that is called off", "G50.1 X0\nG51.1 Y0", "M0")[:1],
    *lone("polar coordinates", "G16", "G15")[:1],
    *lone("a length of a tool by its number", "G43 H1", "G49"),
    *lone("a length of a tool by words", "G43.1 Z5.0", "G49"),
    *lone("a length of a second tool is added", "G43.2 H2", "G49"),
    *lone("a length that counts down", "G44 H1", "G49"),
    *lone("the tool's centre is held by five axes", "G43.4 H1", "G49"),
    *lone("a radius of a tool at the left", "G41 D1", "G40"),
    *lone("a radius of a tool at the right, in words", "G42.1 D6.0", "G40"),
    *lone("a plane that is tilted", "G68.2 X0 Y0 Z0 I30.0 J20.0 K0", "G17"),
    *lone("diameters in place of radii", "G7", "G17"),
    *lone("a cylinder is unrolled", "G7.1 C40.0", "G17"),
    *lone("polar interpolation", "G12.1", "G17"),
    *lone("polar interpolation by its old name", "G112", "G17"),
    *lone("incremental words", "G91", "G90"),
    *lone("another work offset that nobody states", "G58", "G54"),
    *lone("a further work offset by FANUC", "G54.1 P4", "G54"),
    *lone("a further work offset by Haas", "G154 P5", "G54"),
    *lone("a further work offset by LinuxCNC", "G59.1", "G59"),
    *lone("a further work offset by old Haas", "G110", "G55"),
    *lone("a work offset by Siemens", "G505", "G55"),
    *lone("no work offset, by Siemens", "G500", "G55"),
    *lone("Okuma's work offsets", "G15 H2", "G54"),
    *lone("a macro", "G65 P9010 A1.0 B2.0", "G4 P1"),
    *lone("a macro in each block", "G66 P9010 A1.0", "G4 P1"),
    *lone("a subprogram that is not given", "M98 P1000", "M0"),
    *lone("a subprogram on another medium", "M198 P1000", "M0"),
    *lone("an O-word of LinuxCNC", "o<probe_corner> call [10] [5]", "M0"),
    *lone("a parameter of a work offset is written", "#5221=10.0", "M3 S500"),
    *lone("a parameter is written whose number is worked out", "#[5220+#1]=10.0", "M3 S500"),
    *lone("an offset by Siemens", "TRANS X10 Y5", "M3 S500"),
    *lone("an added offset by Siemens", "ATRANS Z2", "M3 S500"),
    *lone("a turn by Siemens", "ROT RPL=45", "M3 S500"),
    *lone("a scale by Siemens", "SCALE X2 Y2", "M3 S500"),
    *lone("a mirror by Siemens", "MIRROR X0", "M3 S500"),
    *lone("a tilted plane by Siemens", 'CYCLE800(1,"TC1",200000,57,0,0,0,0,20,0,0,0,0,1,,1)', "M3 S500"),
    *lone("five axes by Siemens", "TRAORI(1)", "M3 S500"),
    *lone("a frame's component by Siemens", "$P_UIFR[1,X,TR]=5", "M3 S500"),
    *lone("a subprogram by Siemens", "L100 P1", "M3 S500"),
    *lone("a call by name", 'EXTCALL "POCKET.SPF"', "M3 S500"),
    *lone("an operator's switch skips a local zero", "/G52 X5.0", "/M8"),
    *lone("an operator's switch skips incremental words", "/ G91", "/ M8"),
    *lone("a switch with a number", "/2 G55", "/2 M8"),
    *lone("a jump", "IF [#1 EQ 1] GOTO 20\nG52 X5.0\nN20", "N20"),
    *lone("a loop of a macro", "WHILE [#1 LT 3] DO1\nG52 X#1\n#1=#1+1\nEND1", "M1"),
    *lone("a loop of LinuxCNC", "o100 while [#1 LT 3]\nG10 L2 P1 X#1\no100 endwhile", "M1"),
    *lone("a machine builder's macro behind a G-code", "G100 P1 X5.0", "G4 P1"),
    *lone("letters of no size", "g 5 2 x 5", "g 4 p 1")[:1],
    *lone("a word with leading zeros", "G052 X5.0", "G04 P1"),
    *lone("a local zero behind a comment", "(zero) G52 X5.0 ; done", "(zero) M8 ; done"),
    *lone("a local zero between two comments", "(a) G52 (b) X5.0", "(a) M8 (b)"),
    *lone("millimetres are inches, in a block of its own, and by a value that nobody knows", "#1=#2\nG#1", "G21"),
    *lone("a code whose number is worked out", "G[50+#1] X0", "G21"),
    *lone("a zero by an old controller", "G50 X100.0 Z50.0", "G21"),
    *lone("a return to a stored zero", "G54 G10 L2 P1 X0 Y0 Z0 R15.0", "G54"),
)

BLOCKS = (
    *body("incremental behind the words", "G1 ⟦X1.0 Y2.0 Z3.0⟧ §", "G91", "G90"),
    *body("a local zero's axes are no move", "§ ⟦X1.0 Y2.0 Z3.0⟧", "G52", "G1"),
    *body("an arc's end", "G1 X11.0 Y20.0 Z5.0\nG17 § ⟦X40.0 Y30.0 Z5.0⟧§", ("G2", " I10.0 J0"), ("G1", "")),
    *body(
        "an arc's end by its radius", "G1 X11.0 Y20.0 Z5.0\nG17\n§ ⟦X40.0 Y30.0 Z5.0⟧§", ("G3", " R25.0"), ("G1", "")
    ),
    *body("a drilling cycle", "§ ⟦X40.0 Y30.0 Z-5.0⟧§", ("G81", " R2.0 F100"), ("G1", " F100")),
    *body(
        "a place of a drilling cycle", "G81 X10.0 Y10.0 Z-5.0 R2.0 F100\n§⟦X40.0 Y30.0⟧ Z2.0", "", "G80 G0 Z2.0\nG1 "
    )[:1],
    *body("a probing move", "§ ⟦X40.0 Y30.0 Z-5.0⟧ F50", "G38.2", "G1"),
    *body("a skip move", "§ ⟦X40.0 Y30.0 Z-5.0⟧ F50", "G31", "G1"),
    *body("a thread", "§ ⟦X40.0 Y30.0 Z-5.0⟧§", ("G33", " K1.5"), ("G1", "")),
    *body("a spline", "G1 X11.0 Y20.0 Z5.0\n§ ⟦X40.0 Y30.0⟧§", ("G5", " I0 J3.0 P0 Q-3.0"), ("G1", "")),
    *body("a word by a variable", "G1 ⟦X§ Y30.0 Z5.0⟧", "#101", "40.0")[:1],
    *body("a word that is worked out", "G1 ⟦X§ Y30.0 Z5.0⟧", "[#1+40.0]", "40.0")[:1],
    *body("a word by Siemens' increments", "G1 ⟦X§ Y30.0 Z5.0⟧", "=IC(40)", "40.0")[:1],
    *body("a word by Siemens' parameters", "G1 ⟦X§ Y30.0 Z5.0⟧", "=R1", "40.0")[:1],
    *body("an axis twice in a block", "G1 ⟦X40.0 Y30.0 Z5.0§⟧", " X41.0", ""),
    *body("two work offsets in a block", "G1 §⟦X40.0 Y30.0 Z5.0⟧", "G54 G55 ", "G55 "),
    *body("two motions in a block", "§ ⟦X40.0 Y30.0 Z5.0⟧", "G0 G1", "G1"),
    *body("two ways of counting in a block", "§ ⟦X40.0 Y30.0 Z5.0⟧", "G90 G91 G1", "G90 G1"),
    *body("a work offset at the end of a block", "G1 ⟦X40.0 Y30.0 Z5.0⟧ §", "G58", "F300"),
    *body("a local zero in a comment in a comment", "G1 X1.0 Y1.0 Z1.0 (a (b) §⟦X40.0 Y30.0 Z5.0⟧ )", "G1 ")[:1],
    *body("a block behind a comment that ends with a bare CR", f"; zero\r§\n{MOVE}", "G52 X5.0\r", "")[:1],
    *body("blocks parted by a bare CR", f"§\r{MOVE}", "G52 X5.0", "")[:1],
    *body("an open comment", f"§\n{MOVE}", "(zero: G52 X5.0", "(zero: G52 X5.0)")[:1],
    *body("a place of an axis that no one has", "G1 ⟦X40.0 Y30.0 Z5.0⟧§", " A45.0", ""),
    *body("an axis beside those of the slides", "G1 ⟦X40.0 Y30.0 Z5.0⟧§", " W10.0", ""),
    *body("an axis of increments by its letter", "G1 ⟦X40.0 Y30.0 Z5.0⟧§", " U10.0", ""),
    *body("a plot behind the end", "M30\n§", f"%\nO2000\n{MOVE}", "")[:1],
    *body("a plot behind the last percent sign", "%\n§", f"{MOVE}", "")[:1],
    *body(
        "a subprogram of this file that another calls",
        "§\nM98 P2000\nM30\nO2000\nG1 ⟦X40.0 Y30.0 Z5.0⟧\nM99",
        "G52 X5.0",
    )[:1],
    *body("a return to a reference", "G28 ⟦X40.0 Y30.0 Z5.0⟧", "")[:1],
    *body("a return to a second reference", "G30 P2 ⟦X40.0 Y30.0 Z5.0⟧", "")[:1],
    *body("a number that is none", "G1 ⟦X§ Y30.0 Z5.0⟧", "4.0.0", "4.0")[:1],
    *body("a number with a sign too many", "G1 ⟦X§ Y30.0 Z5.0⟧", "--4.0", "-4.0"),
    *body("a number beyond all slides", "G1 ⟦X§ Y30.0 Z5.0⟧", "4000000000.0", "4.0")[:1],
    *body("a letter without number", "G1 ⟦X40.0 Y Z5.0⟧§", "")[:1],
    *body("a macro for each block, and words of a move", "G66 P9010 A1.0\n§⟦X40.0 Y30.0 Z5.0⟧\nG67", "G1 ")[:1],
    *body("a corner is cut by words", "G1 ⟦X40.0 Y30.0 Z5.0⟧§", ",R5.0", "")[:1],
    *body("an angle in place of a word", "G1 ⟦X40.0⟧§", ",A30.0", "")[:1],
)

FLOW = (
    *twins(
        "the end leads back to the beginning with another zero in force",
        {"p.nc": f"G21 G90 G17\n{MOVE}\n§\nG1 X1.0 Y1.0 Z1.0\nM99\n"},
        "G52 X5.0",
        "G4 P1",
        FRAMES,
    )[:1],
    *twins(
        "the end leads back to the beginning with another work offset in force",
        {"p.nc": f"G21 G90 G17\n{MOVE}\n§\nG1 X1.0 Y1.0 Z1.0\nM99\n"},
        "G55",
        "G4 P1",
        FRAMES,
    )[:1],
    *twins(
        "a jump back with incremental words in force",
        {"p.nc": f"G21 G90 G17 G54\nN10 {MOVE}\n§\nG1 X1.0 Y1.0 Z1.0\nIF [#1 LT 5] GOTO 10\nM30\n"},
        "G91",
        "G4 P1",
        FRAMES,
    )[:1],
    *twins(
        "a block is repeated by Siemens with another zero in force",
        {"p.nc": f"G21 G90 G17 G54\nBEGIN:\n{MOVE}\n§\nREPEAT BEGIN P=2\nM30\n"},
        "ATRANS X5",
        "G4 P1",
        FRAMES,
    )[:1],
    *twins(
        "inches where millimetres were",
        {"p.nc": f"G90 G17 G54\n§\n{MOVE}\nM30\n"},
        "G[#500]",
        "G20",
        FRAMES,
    ),
    *twins("units that nobody states", {"p.nc": f"G90 G17 G54\n§\n{MOVE}\nM30\n"}, "", "G21", FRAMES)[1:],
    *twins(
        "a zero that is set in an arm of a condition",
        {"p.nc": f"{HEAD}o10 if [#1 GT 0]\n§\no10 endif\n{MOVE}\nM2\n"},
        "G92 X0",
        "",
        FRAMES,
    )[:1],
    *twins(
        "a subprogram sets another zero",
        {"p.ngc": f"o100 sub\n§\no100 endsub\n{HEAD}o100 call\n{MOVE}\nM2\n"},
        "G92 X0",
        "",
        FRAMES,
    )[:1],
)

REACHES_NOTHING = (
    Attack(
        "control: comments with words of zeros",
        {
            "p.nc": f"{HEAD}(G52 X5.0)\n; G91\nG4 P0.5 (TRANS X10)\n{MOVE} (G92 X0) ; G10\nM30\n".replace(
                "⟦", "⟨"
            ).replace("⟧", "⟩")
        },
        FRAMES,
    ),
    Attack(
        "control: a zero that is called off, and full words behind it",
        {"p.nc": f"{HEAD}G92 X0 Y0\nG1 ⟦X1.0 Y2.0 Z3.0⟧\nG92.1\nG1 ⟨X30.0 Y40.0 Z6.0⟩\nM30\n"},
        FRAMES,
    ),
    Attack(
        "control: lengths of tools called off",
        {"p.nc": f"{HEAD}G43 H1\nG1 ⟦X1.0 Y2.0 Z3.0⟧\nG49\nG1 ⟨X30.0 Y40.0 Z6.0⟩\nM30\n"},
        FRAMES,
    ),
    Attack(
        "control: steps, and counting from the zero again",
        {"p.nc": f"{HEAD}G91\nG1 ⟦X1.0 Y2.0 Z3.0⟧\nG90\nG1 ⟨X30.0 Y40.0 Z6.0⟩\nM30\n"},
        FRAMES,
    ),
    Attack(
        "control: small letters, no blanks, signs, points, CRLF",
        {"p.nc": "%\r\no1000\r\nn10g21g90g17g54\r\nn20g01⟨x+10.y-.5z5.⟩f500\r\nn30⟨X12.Y0.5Z-0.25⟩\r\nm30\r\n%\r\n"},
        FRAMES,
    ),
)

GRID = [(10.0 + 12.5 * (k % 5), -40.0 + 8.25 * (k // 5), 5.0 - 0.5 * (k % 3)) for k in range(20)]
"""Places of plain programs, [mm]."""


def words(count: int, digits: int = 3, size: float = 1.0, gap: str = " ") -> list[str]:
    """Axis words with marks around them."""
    return [
        "⟨" + gap.join(f"{k}{v / size:.{digits}f}" for k, v in zip("XYZ", xyz, strict=True)) + "⟩"
        for xyz in GRID[:count]
    ]


def plain(name: str, lines: Sequence[str], end: str = "\n", file: str = "plain.nc") -> Attack:
    """A plain program of which all axis words are marked."""
    return Attack(f"plain: {name}", {file: end.join([*lines, ""])}, FRAMES)


PLAIN = (
    plain(
        "CAM output for milling",
        [
            "%",
            "O1001 (CONTOUR)",
            "(T1 D=6. CR=0. - ZMIN=-1. - flat end mill)",
            "G90 G94 G17 G49 G40 G80",
            "G21",
            "G54",
            "S5000 M3",
            "M8",
        ]
        + [f"N{10 * k} G1 {w} F{300 + 10 * k}." for k, w in enumerate(words(18), start=1)]
        + ["M9", "M5", "M30", "%"],
    ),
    plain(
        "motion stated once", ["G21 G90 G17 G54", "G1 F800"] + [f"{w}" for w in words(16, 4)] + ["M2"], file="plain.ngc"
    ),
    plain(
        "two work offsets",
        ["G21 G90 G17", "G54"]
        + [f"G0 {w}" for w in words(7, 2)]
        + ["G55"]
        + [f"G01 {w} F200" for w in words(7, 2)]
        + ["G59"]
        + [f"G1 {w}" for w in words(4, 2)]
        + ["M30"],
    ),
    plain("inches", ["G20 G90 G17 G54"] + [f"G1 {w} F20." for w in words(12, 4, 25.4)] + ["M30"]),
    plain(
        "laser with outputs between moves",
        ["G21 G90 G17 G54", "M5"]
        + [f"G1 {w} F1500\nM3 S{100 + k}\nG4 P0.1\nM5" for k, w in enumerate(words(10))]
        + ["M2"],
    ),
    plain(
        "small letters without blanks",
        ["g21g90g17g54"] + [f"n{k}g1{w.lower()}f900" for k, w in enumerate(words(12, 3, gap=""), start=1)] + ["m30"],
        "\r\n",
    ),
    plain(
        "comments in umlauts, tabs",
        ["%", "(Schweißportal: Übergang)", "G21\tG90\tG17\tG54"]
        + [f"G1\t{w}\tF300\t; Stück {k}: G91" for k, w in enumerate(words(10))]
        + ["M30", "%"],
    ),
    plain(
        "path control of LinuxCNC and plane words",
        ["G21 G90 G17 G40 G49 G54 G80 G94 G91.1", "G64 P0.01"]
        + [f"G0 {a}\nG1 {b} F600" for a, b in zip(words(16)[0::2], words(16)[1::2], strict=True)]
        + ["M2"],
        file="plain.ngc",
    ),
    plain(
        "by hand, stops and coolant",
        ["G21 G90 G17 G54", "M3 S2000"]
        + [f"G00 {w} (hole {k})\nM{(0, 1, 8, 9)[k % 4]}" for k, w in enumerate(words(9, 1))]
        + ["M30"],
    ),
    plain(
        "numbers of blocks, signs, few digits",
        ["N5 G21 G90 G17 G54"]
        + [f"N{k * 5} G01 {w.replace('X', 'X+')} F250." for k, w in enumerate(words(14, 2), start=2)]
        + ["N500 M30"],
    ),
)

SHOPS = (
    *lone("a comment that opens in another, over lines", ";(\nG52 X5.0\n;)", ";(\nM8\n;)"),
    *lone("a semicolon in a comment, and a zero behind it", "(;) G52 X5.0", "(;) M8"),
    *lone("incremental words of a return that stay", "G91 G28 Z0", "G90"),
    *lone("modes that are kept and brought back", "G91\nM70\nG90\nM72", "G91\nG90"),
    *lone("a plane that is tilted, turned to", "G53.1", "G17"),
    *lone("inches by Siemens or a lathe's cycle", "G70", "G21"),
    *lone("a length of a tool by Siemens", 'T="MILL6"\nD1', "M3 S500"),
    Attack(
        "a subprogram of the same file by Haas",
        {"p.nc": f"G21 G90 G17 G54\nG1 X1.0 Y2.0 Z3.0\nM97 P100\n{MOVE}\nM30\nN100 G52 X5.0\nM99\n"},
        FRAMES,
    ),
    *lone("a cycle at each place by Siemens", "MCALL CYCLE81(5,0,1,-5)", "M0"),
    *lone("a frame's product by Siemens", "$P_PFRAME=CTRANS(X,10)", "M0"),
    *lone("Heidenhain's shift", "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+5", "M0"),
    *lone("a printer's bed is measured", "G29", "M0"),
    *lone("a printer's home is shifted", "M206 X5.0", "M0"),
    *lone("a printer's probe is shifted", "M851 Z-0.5", "M0"),
    *lone("a code of the machine builder's", "M150", "M0"),
    *lone("a block number with the zero close behind", "N10G52X5.0", "N10M8"),
    *lone("a zero in letters of two sizes", "g52X5.0", "m8"),
    *lone("an axis is written to by a parameter of the controller", "#5421=3.0", "M0"),
    *lone("a stop from which the operator goes on with anything", "M0\nG[#1]", "M0"),
    *lone("a scale, turned off in part", "G51 X0 Y0 I2.0 J2.0", "G50")[:1],
    *body("a sum over the block's letters", "§G1 ⟦X30.0 Y40.0 Z6.0⟧ F500§", ("N3 ", "*97"), ("N3 ", "")),
    *body("a comma in place of a point", "G1 ⟦X30§0 Y40.0 Z6.0⟧", ",", "."),
    *body("a switch within a block", "G1 ⟦X30.0 Y40.0 Z6.0⟧ §", "/X35.0", "F300"),
    *body("an angle from the pole", "G1 ⟦X30.0 Y40.0 Z6.0⟧ §", "^30", "F300"),
    *body("a call behind a block's words", "G1 X1.0 Y1.0 Z1.0 §\n" + MOVE, "M98 P100", "F300"),
    *body("the length of a tool in the move's own block", "G1 §⟦X30.0 Y40.0 Z6.0⟧", "G43 H1 ", ""),
    *body("a radius of a tool in the move's own block", "G1 §⟦X30.0 Y40.0 Z6.0⟧", "G41 D1 ", ""),
    *body("steps in the move's own block", "G1 §⟦X30.0 Y40.0 Z6.0⟧", "G91 ", ""),
    *body("machine coordinates of one letter, by Okuma's word", "G15 §\n" + MOVE, "H0", "")[:1],
    *body("an axis by its letter and number, by Siemens", "G1 ⟦X§30.0 Y40.0 Z6.0⟧", "1=", ""),
    *body("an absolute word among steps, by Siemens", "G91\nG1 ⟦X§ Y40.0 Z6.0⟧\nG90", "=AC(30.0)", "30.0")[:1],
    *body("a chamfer in the block", "G1 ⟦X30.0 Y40.0 Z6.0⟧ §\nG1 X60.0 Y80.0 Z6.0", "CHF=2", "F300"),
    *body("a thread by a tap", "§ ⟦X40.0 Y30.0 Z-5.0⟧§", ("G33.1", " K1.0"), ("G1", "")),
    *body(
        "cycles that go on behind their block",
        "G81 X10.0 Y10.0 Z-5.0 R2.0 F100\n§",
        "⟦X40.0 Y30.0 Z-5.0⟧",
        "G80\nG1 ⟨X40.0 Y30.0 Z5.0⟩",
    ),
    *body("a bore that shifts the tool", "§ ⟦X40.0 Y30.0 Z-5.0⟧§", ("G76", " R2.0 Q0.5 F100"), ("G1", " F100")),
    Attack(
        "control: letters whose second byte some take for the end of a line",
        {"p.nc": f"{HEAD}; Å G52 X5.0\n(à\xa0G52 X5.0)\n{MOVE}\nM30\n".replace("⟦", "⟨").replace("⟧", "⟩")},
        FRAMES,
    ),
    Attack(
        "control: outputs and waits of LinuxCNC",
        {"p.ngc": f"{HEAD}M62 P0\nM64 P1\nM66 P0 L0\nM68 E0 Q1.5\n{MOVE}\nM2\n".replace("⟦", "⟨").replace("⟧", "⟩")},
        FRAMES,
    ),
    Attack(
        "control: parameters of the program's own",
        {"p.ngc": f"{HEAD}#100=5\n#<depth>=[#100*2]\n#101=[#100+1]\n{MOVE}\nM2\n".replace("⟦", "⟨").replace("⟧", "⟩")},
        FRAMES,
    ),
)

ENDS = (
    Attack(
        "a block behind a comment that a bare CR ends, with other line ends about",
        {"p.nc": f"G21 G90 G17 G54\r\n; next\rG91\r\n{MOVE}\r\nM30\r\n"},
        FRAMES,
    ),
    Attack(
        "a whole program with bare CR, and a zero in it", {"p.nc": f"G21 G90 G17 G54\rG52 X5.0\r{MOVE}\rM30\r"}, FRAMES
    ),
    Attack("a form feed between words", {"p.nc": "G21 G90 G17 G54\nG1\fG91 ⟦X1.0 Y2.0 Z3.0⟧\nM30\n"}, FRAMES),
    *lone("a zero behind a tab", "\tG52\tX5.0", "\tM8"),
    *lone("a zero in a block that is numbered twice", "N10 N20 G52 X5.0", "N10 M8"),
    Attack(
        "a zero by small letters in a macro's branch",
        {"p.nc": f"G21 G90 G17 G54\nif [#1 gt 0] then g52 x5\n{MOVE}\nM30\n"},
        FRAMES,
    ),
    *lone("a parameter that is the work offset, by its name", "#<_ini[axis_x]home>=5\n#5241=2.0", "M8"),
    *lone("a loop of Siemens", "FOR R1=1 TO 3\nATRANS X5\nENDFOR", "M8"),
    *lone("a label, and a jump of Siemens", "IF R1>0 GOTOF ENDE\nTRANS X5\nENDE:", "M8"),
    *lone("a coordinate turn by Heidenhain's or Okuma's word", "G11 X0 Y0 P30", "M8"),
    *lone("a figure is turned by Mitsubishi's word", "G68.1 X0 Y0 Z0 I0 J0 K1 R10.0", "G69"),
)

ATTACKS: tuple[Attack, ...] = (*STATE, *BLOCKS, *FLOW, *REACHES_NOTHING, *ENDS, *PLAIN, *SHOPS)
