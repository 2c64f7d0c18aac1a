from aridcal.drawing.html import styled_page
def fleet_page(ran, title):
    return styled_page(title, "x")
