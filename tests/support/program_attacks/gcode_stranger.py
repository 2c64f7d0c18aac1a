"""G-code by somebody who had not seen the reader: dialects in which a word means something else, modes that survive."""

from __future__ import annotations

from program_attacks import Attack

FRAMES = """format: 1
bases:
  G54: {xyz: [0.1, 0.05, 0], rpy: [0, 0, 0]}
  G55: {xyz: [0.3, 0.1, 0], rpy: [0, 0, 0]}
  G58: {xyz: [0.2, 0.1, 0], rpy: [0, 0, 0]}
  G59: {xyz: [0.2, 0.2, 0], rpy: [0, 0, 0]}
tools: {default: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}
"""
HEAD = "%\nO0100 (SIDE PLATE)\nG21 G90 G17 G40 G49 G80 G94\nG54\nS8000 M3\nG0 X⟨10.⟩ Y⟨10.⟩ Z⟨50.⟩\n"


def _case(name: str, body: str, behind: str = "M30\n%\n", ending: str = "nc", head: str = HEAD) -> Attack:
    return Attack(name, {f"plate.{ending}": head + body.strip("\n") + "\n" + behind}, FRAMES)


NEXT = "G1 X⟦20.5⟧ Y⟦30.25⟧ Z⟦-1.5⟧ F500"
FINE = "G1 X⟨20.5⟩ Y⟨30.25⟩ Z⟨-1.5⟩ F500"
PLAIN = "%\nG21 G90 G54\nG0 X⟦10.⟧ Y⟦10.⟧ Z⟦50.⟧\n"

ATTACKS = [
    _case("plain moves", f"{FINE}\nX⟨25.⟩ Y⟨31.⟩ Z⟨-1.5⟩\nG4 P0.5\nM8\nG61\nG64\nG0 X⟨0.⟩ Y⟨0.⟩ Z⟨50.⟩\nM9\nM5"),
    _case("G58 with words is a programmed offset on Siemens", "G58 X⟦10.⟧ Y⟦5.⟧ Z⟦0.⟧\n" + NEXT),
    _case("G59 with words and a move is FANUC's", "G0 G59 X⟨10.⟩ Y⟨5.⟩ Z⟨0.⟩\n" + FINE),
    _case("FANUC's lathes set the zero by G50", "G50 X10. Z5.\n" + NEXT),
    _case("a firmware's retraction", f"G10\n{FINE}\nG11\n{FINE}"),
    _case(
        "Heidenhain's DIN/ISO ends its blocks by stars",
        "N30 G01 X+⟦20.5⟧ Y+⟦30.25⟧ Z-⟦1.5⟧ F500 *\nN40 X+⟦22⟧ Y+⟦31⟧ Z-⟦2⟧ *",
        head="%PLATE G71 *\nN10 G90 G17 *\nN20 G54 X+10 Y+5 *\n",
        behind="N99 M30 *\n",
    ),
    _case("Siemens incremental per word", "G1 X=IC(⟦20.5⟧) Y=IC(⟦3.5⟧) Z⟦5.5⟧\n" + "G1 X=AC(⟦20.5⟧) Y⟦2.⟧ Z⟦5.⟧"),
    _case("Siemens polar", "G111 X0. Y0.\nG1 AP=30 RP=50 Z⟦-2.5⟧\n" + NEXT),
    _case("Siemens frame variable", "$P_UIFR[1,X,TR]=20\n" + NEXT),
    _case("Siemens programmable frame", "ATRANS X20. Y5.\n" + NEXT + "\nTRANS\n" + NEXT),
    _case("Siemens inches by G700", "G700\n" + FINE + "\nG710\n" + FINE),
    _case("Siemens inches by G70", "G70\n" + NEXT),
    _case("Siemens suppression of frames", "SUPA G0 X⟦20.5⟧ Y⟦3.25⟧ Z⟦0.⟧\nG153 G0 X⟦20.5⟧ Y⟦3.25⟧ Z⟦0.⟧"),
    _case("Siemens text in a block", 'MSG("G1 X5 Y5") G1 X⟦20.5⟧ Y⟦30.25⟧ Z⟦-1.5⟧'),
    _case("Okuma's G15 chooses an offset", "G15 H2\n" + NEXT),
    _case("Okuma writes an offset", "VZOFX[1]=20\n" + NEXT),
    _case("polar coordinates", f"{FINE}\nG16\nG1 X⟦50.⟧ Y⟦30.⟧ Z⟦-1.5⟧\nG15\n{FINE}"),
    _case("mirror of Haas", f"{FINE}\nG101 X0\n{NEXT}\nG100 X0\n"),
    _case("Haas measures an offset", f"{FINE}\nG136 Y0. Z-1. D1 F10\n{NEXT}"),
    _case(
        "Haas local subprogram with an offset",
        f"{NEXT}\nM97 P100\n{NEXT}",
        head=PLAIN,
        behind="M30\nN100 G52 X10. Y0.\nM99\n%\n",
    ),
    _case(
        "a subprogram of the same file changes to increments",
        f"{FINE}\nM98 P200\n{NEXT}",
        behind="M30\nO0200\nG91\nM99\n%\n",
    ),
    _case(
        "a subprogram called several times",
        f"{FINE}\nM98 P200 L3\nG90 G54\n{FINE}",
        behind="M30\nO0200\nG91 G1 X⟦5.⟧ Y⟦0.⟧ Z⟦0.⟧\nG90\nM99\n%\n",
    ),
    _case("a macro is called at each block", f"{FINE}\nG66 P9100 A5.\nX⟦20.⟧ Y⟦20.⟧ Z⟦5.⟧\nG67\n"),
    _case("a macro variable in the middle", f"{FINE}\n#101=20.5\nG1 X#101 Y⟦30.25⟧ Z⟦-1.5⟧\n"),
    _case("a system variable writes the offset", f"{FINE}\n#5221=#5221+0.5\n{NEXT}"),
    _case("a system variable of the second control writes the offset", f"{FINE}\n#2501=20.\n{NEXT}"),
    _case(
        "numbers without a point",
        "G1 X⟦20⟧ Y⟦30⟧ Z⟦-1⟧ F500",
        head="%\nO0100\nG21 G90 G17 G54\nG0 X⟦10.⟧ Y⟦10⟧ Z⟦50⟧\n",
    ),
    _case("blanks in numbers", "G1 X⟦2.0 5⟧ Y⟦30.25⟧ Z⟦-1.5⟧\n" + FINE),
    _case("an expression for a word", f"G1 X[⟦20.5⟧+1] Y30.25 Z-1.5\n{FINE}", ending="ngc"),
    _case("LinuxCNC: python in a comment", f"{FINE}\n;py,self.set_offset(0)\n{NEXT}", ending="ngc"),
    _case("LinuxCNC: polar words", f"{FINE}\nG1 @10 ^45\nG1 @⟦10.5⟧ ^⟦30.⟧ Z⟦1.⟧\n", ending="ngc"),
    _case("LinuxCNC: user's M code", f"{FINE}\nM110 P1\n{NEXT}", ending="ngc"),
    _case("LinuxCNC: a named subprogram in another file", f"{FINE}\no<toolchange> call [3]\n{NEXT}", ending="ngc"),
    _case(
        "LinuxCNC: modes are kept by the called one",
        f"{FINE}\no100 call\n{NEXT}",
        behind="M2\n%\n",
        ending="ngc",
        head="o100 sub\nM73\nG91 G20\nG1 X⟦1.5⟧ Y⟦1.5⟧ Z⟦1.5⟧\no100 endsub\n"
        + HEAD.replace("%\nO0100 (SIDE PLATE)\n", ""),
    ),
    _case("a tool with its offset, as lathes have it", f"{FINE}\nT0101\n{NEXT}"),
    _case("a tool of four digits that is put in", f"{FINE}\nT0101 M6\n{FINE}\nT0002\n{FINE}"),
    _case("a printer's progress", f"M73 P10 R12\n{FINE}\nM73 P50 R5\n{FINE}", ending="gcode"),
    _case(
        "LinuxCNC: while with an offset",
        f"{FINE}\n#1=0\no101 while [#1 LT 3]\n{NEXT}\nG92 X0\n#1=[#1+1]\no101 endwhile\n",
        ending="ngc",
    ),
    _case(
        "LinuxCNC: comments that do nothing",
        f"(MSG, start)\n(DEBUG, at #5420)\n(PRINT, a)\n(LOG, b)\n; G91\n{FINE}",
        ending="ngc",
    ),
    _case("probe writes where it was", f"{FINE}\nG38.2 Z⟦-20.⟧ F50\nG10 L20 P1 Z0\n{NEXT}", ending="ngc"),
    _case("a temporary offset by words in a call", f"{FINE}\nG52 X5. Y0.\n{NEXT}\nG52 X0. Y0. Z0.\n{FINE}"),
    _case("rotary fixture offset", f"{FINE}\nG54.2 P1\n{NEXT}\n"),
    _case("table of workpiece errors", f"{FINE}\nG54.4 P2\n{NEXT}\n"),
    _case("tool centre point control", f"{FINE}\nG43.4 H1\n{NEXT}\n"),
    _case("tilted plane", f"{FINE}\nG68.2 X0 Y0 Z0 I0 J30. K0\nG53.1\n{NEXT}\nG69\n"),
    _case("a tool length that is not stated", f"{FINE}\nT2 M6\nG43 H2 Z⟦50.⟧\n{NEXT}\n"),
    _case("cutter radius", f"{FINE}\nG41 D1\n{NEXT}\nX⟦30.⟧ Y⟦30.⟧ Z⟦-1.5⟧\nG40\n"),
    _case("cylinder", f"{FINE}\nG07.1 C50.\n{NEXT}\nG07.1 C0\n"),
    _case("drilling cycle", f"{FINE}\nG98 G81 X⟦5.⟧ Y⟦5.⟧ Z⟦-10.⟧ R⟦2.⟧ F100\nX⟦15.⟧ Y⟦5.⟧\nG80\n{FINE}"),
    _case("a hole circle", f"{FINE}\nG70 I20. J0 L6\n{NEXT}\n"),
    _case("home by a point between", f"{FINE}\nG91 G28 Z0\nG90\n{FINE}\nG28 X⟦5.⟧ Y⟦5.⟧ Z⟦20.⟧\n"),
    _case("machine coordinates for one block", f"{FINE}\nG53 G0 Z0.\n{FINE}"),
    _case("skipped blocks with another mode", f"{FINE}\n/G91\n{NEXT}\nG90\n{FINE}"),
    _case("skipped blocks by number with another offset", f"{FINE}\n/2 G55\n{NEXT}\nG54\n{FINE}"),
    _case("Marlin: an offset of home", f"{FINE}\nM206 X5.\n{NEXT}\n", ending="gcode"),
    _case("Marlin: levelling and extruder", "G29\nM420 S1\n" + NEXT, ending="gcode"),
    _case("Klipper: an offset by a macro", f"{FINE}\nSET_GCODE_OFFSET Z=0.2 MOVE=1\n{NEXT}", ending="gcode"),
    _case("RepRap: a variable in braces", f"{FINE}\nvar x = 20.5\nG1 X{{var.x}} Y⟦30.25⟧ Z⟦-1.5⟧\n", ending="gcode"),
    _case("RepRap: skew", f"{FINE}\nM556 S100 X1.5 Y0 Z0\n{NEXT}", ending="gcode"),
    _case("RepRap: tool with an offset", f"{FINE}\nG10 P1 X5. Y0. Z0.\nT1\n{NEXT}", ending="gcode"),
    _case("Grbl: a setting", f"{FINE}\n$110=500\n{NEXT}", ending="gcode"),
    _case("Grbl: a jog", f"{FINE}\n$J=G91 X⟦10.0⟧ F500\n", ending="gcode"),
    _case("Mach3 and Fanuc: a global scale", f"{FINE}\nG51 X0 Y0 Z0 P2000\n{NEXT}\nG50\n{FINE}"),
    _case("Fagor: a pattern", f"{FINE}\nG73 Q45\n{NEXT}\n"),
    _case("a feed in inverse time", f"{FINE}\nG93 G1 X⟨21.⟩ Y⟨31.⟩ Z⟨-1.⟩ F2.5\nG94\n{FINE}"),
    _case("thread cutting with I J K", f"{FINE}\nG33.1 Z⟦-20.⟧ K1.5\n", ending="ngc"),
    _case("a spline", f"{FINE}\n{NEXT}\nG5 I0 J3 P0 Q-3 X⟦1.⟧ Y⟦1.⟧\n", ending="ngc"),
    _case("a form feed in a comment", f"(old \x0c G91)\n{FINE}\n; \x85 G91 \x0b G20\n{FINE}"),
    _case("diameter", f"{FINE}\nG7\n{NEXT}\nG8\n{FINE}", ending="ngc"),
]
