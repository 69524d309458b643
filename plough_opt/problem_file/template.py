"""The commented problem file that `plough-opt init` writes."""

TEMPLATE = """\
#:schema plough-opt.schema.json
# The line above lets editors complete keys, after: plough-opt schema > plough-opt.schema.json
# A design question for plough_opt. Quantities, including angles, are text with a unit.
#   plough-opt check FILE       check the file, and show what the scene contains
#   plough-opt simulate FILE    compute the response at the guesses below
#   plough-opt optimise FILE    find the best share, and what limits it
#   plough-opt tradeoff FILE    trade the results in a table [trade_off] against each other
title = "Subsoiler for cotton on serozem"

[soil]
name = "serozem"                  # list them with: plough-opt soils; override any property below, such as
# cohesion = "25 kPa"             # or give all: density, density_ratio, cohesion, friction_angle, tool_friction
# ambient_pressure = "5 kPa"      # default: the atmosphere; for soil with open pores, the overburden

[share]
chisel_angle = "15 deg"           # a quantity that is neither here nor a variable is reported as missing

[scene]
tow_speed = "7.2 km/h"
frame_mass = "20 kg"              # mass that moves with the share
steel_density = "7850 kg/m^3"     # adds the share's own mass, that of a solid cone
duration = "2 s"
# outputs = 400                   # intervals between output times; limits "at every output" are checked there
# medium = "mckyes_ali"           # another law of resistance, or { law = "mckyes_ali", depth = "30 cm" }

[effects]                         # for the defaults of omitted effects: plough-opt check FILE --effects
strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }
damping = "400 N*s/m"
# start = "rest"                  # default "equilibrium": start at the steady deflection
# tow_ramp = "0.5 s"              # the strut reaches its speed smoothly
# motion = false                  # quasi-static: solve no equation of motion
# rate_term = "0.01 s^2/m^2"      # F0 (1 + kappa L'^2), for calibration
# contact = "stick_slip"          # stick, slip and gap by events; or "smooth" with contact_width = "0.05 m/s"
# breakaway = 1.2                 # for stick_slip: resistance of a resting share over that of a slipping share
# entry = true                    # start at first contact; needs start = "rest" or "towed"
# orbit = "periodic"              # the periodic orbit, without a transient: remove the duration; cheaper:
#                                 # "linearised" for small waves, or "harmonic_balance" with harmonics = 3
# formulation = "printed"         # the source's equations with their misprints, to show what these change

[variables]                       # quantities to choose, between bounds, starting from a guess
"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }
"share.height"      = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }
"scene.stiffness"   = { lower = "10 kN/m", upper = "1000 kN/m", guess = "50 kN/m", log = true }
# the manufacturing tolerance is 0.3 % of the range, unless a key "tolerance" sets it, such as "1 mm" or "0.5 %"

[minimise]                        # the sum of these: mean_draft/1 kN + force_rms/1 kN
# over = "worst"                  # minimise the worst (or "mean") over the tolerances, and require all limits there
mean_draft = { per = "1 kN" }
force_rms  = { per = "1 kN" }

[require]
loosened_radius = { at_least = "0.15 m" }
half_angle      = { at_most = "15 deg" }     # of the equivalent cone; above 20 deg the theory does not hold
deflection      = { at_most = "0.12 m" }     # at every output time; mean_deflection limits the average

# [shares.front]                  # several shares in one frame, designed as one machine: the table of each share
# [shares.rear]                   # overrides entries of the tables above, and may be empty
# soil.cohesion = "15 kPa"
# variables."share.height" = { upper = "0.4 m" }        # chosen for this share alone

# [measures]                      # your own results, to minimise, require or trade like the others
# power_per_width = { value = "tow_power / (2 * loosened_radius)", unit = "kW/m" }
"""
