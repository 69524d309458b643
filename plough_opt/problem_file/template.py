"""The commented problem file that `plough-opt init` writes."""

TEMPLATE = """\
#:schema plough-opt.schema.json
# An editor that knows TOML schemas completes keys by the line above after: plough-opt schema > plough-opt.schema.json
# A design question for plough_opt. Quantities are text with a unit; angles too.
#   plough-opt check FILE       is everything right, and what does the scene contain?
#   plough-opt simulate FILE    the response at the guesses below
#   plough-opt optimise FILE    the best share, and what decided it
#   plough-opt tradeoff FILE    two results against each other: a table [trade_off] names them
title = "Subsoiler for cotton on serozem"

[soil]
name = "serozem"                  # one of: plough-opt soils; any property may be overridden below, such as
# cohesion = "25 kPa"             # or give all: density, density_ratio, cohesion, friction_angle, tool_friction
# ambient_pressure = "5 kPa"      # the atmosphere by default; the overburden, for soil with open pores

[share]
chisel_angle = "15 deg"           # what is neither here nor among the variables is reported as missing

[scene]
tow_speed = "7.2 km/h"
frame_mass = "20 kg"              # what moves with the share
steel_density = "7850 kg/m^3"     # the share's own mass, a solid cone, is added
duration = "2 s"
# outputs = 400                   # intervals between output times; limits "at every output" are checked there
# medium = "mckyes_ali"           # another law of resistance, or { law = "mckyes_ali", depth = "30 cm" }

[effects]                         # what is left out is off, or as: plough-opt check FILE
strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }
damping = "400 N*s/m"
# start = "rest"                  # default "equilibrium": at the steady deflection
# tow_ramp = "0.5 s"              # the strut reaches its speed smoothly
# motion = false                  # quasi-static: no equation of motion at all
# rate_term = "0.01 s^2/m^2"      # F0 (1 + kappa L'^2), for calibration
# contact = "stick_slip"          # stick, slip and gap by events; or "smooth" with contact_width = "0.05 m/s"
# breakaway = 1.2                 # of stick and slip: resistance of a share at rest over that of one that slips
# entry = true                    # from first contact; needs start = "rest" or "towed"
# the lasting motion instead of one from a start: orbit, "periodic", "linearised" or "harmonic_balance" (harmonics)
# formulation = "printed"         # the source's equations with the errors of its print, to show what these do

[variables]                       # what to choose, between bounds, starting from a guess
"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }
"share.height"      = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }
"scene.stiffness"   = { lower = "10 kN/m", upper = "1000 kN/m", guess = "50 kN/m", log = true }
# each is made within a tolerance, 0.3 % of its range; the key "tolerance" says otherwise, like "1 mm" or "0.5 %"

[minimise]                        # the sum of these: mean_draft/1 kN + force_rms/1 kN
# over = "worst"                  # or "mean": within the tolerances, the requirements kept everywhere in them
mean_draft = { per = "1 kN" }
force_rms  = { per = "1 kN" }

[require]
loosened_radius = { at_least = "0.15 m" }
half_angle      = { at_most = "15 deg" }     # of the equivalent cone; above 20 deg the theory does not hold
deflection      = { at_most = "0.12 m" }     # at every output time; mean_deflection limits the average

# [shares.front]                  # several shares in one frame, designed as one machine: each has a table that says
# [shares.rear]                   # what differs from the tables above, an empty one for nothing
# soil.cohesion = "15 kPa"
# variables."share.height" = { upper = "0.4 m" }        # chosen for this share alone

# [measures]                      # results of your own, to minimise, require or trade like the others
# power_per_width = { value = "tow_power / (2 * loosened_radius)", unit = "kW/m" }
"""
