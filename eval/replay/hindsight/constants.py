"""All constants of `jcbb-hindsight`, in SLAM and in a known map, in one file: what each of them means.

They are read as `constants.NAME` where they are used. Probabilities of gates are chi-square probabilities, 2 dof unless
said otherwise; "ranges" are ranges of the sensor. Compiled kernels get them as arguments: a kernel in the cache would
not notice that a constant was changed. The errors of odometry that the deciding filter estimates
(`mapper`) and the pose hypotheses (`hypotheses`) have their constants beside them.
"""

from __future__ import annotations

import math

from association.conditional import EXACT_VARIANCE as EXACT_VARIANCE
from association.conditional import FREEDOM as FREEDOM
from association.conditional import SAME_PLACE as SAME_PLACE

# --- Innovations: how large the noise really is (noise.py) ----------------------------------------------------------

NOISE_MEMORY = 1000.0
"""Innovations over which a scale of the noise is learned."""
NOISE_PRIOR = 10.0
"""Innovations that the stated noise is worth at the beginning, in a known map."""
LEAST_SCALE = 0.01
"""The noise is not taken for less than this share (of variance) of what was stated."""

# --- Learned gates of SLAM (eval/replay/hindsight/gates.py, tentative.py, eval/replay/hindsight/gates.py) -------------

TAILS = 2.0
"""Variance of Student's t with four degrees of freedom, in units of its scale: the Gaussian that gates in its place."""
SCALES_PRIOR = 3.0
"""Innovations that the stated noise is worth at the beginning, in SLAM."""
LEAST_SHARE = 1e-12
"""What an innovation tells of a scale is divided by its share in the covariance, or by this where that is none."""
FALSE_REJECTION = 0.01
"""Share of observations that the gate of pairings is to leave out."""
TAILS_STEP = 0.1
"""Of the logarithm of the gate, for one observation left out, at most; ..."""
TAILS_HORIZON = 30.0
"""... later this by the number of observations, as much as one in a tail that falls with d^-4 tells; ..."""
TAILS_SLOWEST = 0.03
"""... and at least this: the tails may change."""
AGREE = 3
"""Observations that must agree with each other, and with no landmark, to be a new one."""
AGREE_GATE = 0.99
"""Probability inside which two observations agree, by the stated noise of the sensor."""

# --- Noise told by consecutive frames (eval/replay/hindsight/noise.py, eval/replay/hindsight/noise.py) --------

DIFFERENCES_MOST = 128
"""Steps from one frame to the next that are looked at, the first of a log; twice as many tell no more."""
DIFFERENCES_PRIOR = 5.0
"""Pairs of readings, and steps, that the stated noise is worth."""
DIFFERENCES_ROUNDS = 40
"""Of expectation maximization."""
DIFFERENCES_WIDE = 25.0
"""Variance of readings of what moved by itself, in that of the others."""
UNDERSTATED = 1.6
"""A sigma is understated if it is so many times the stated one. In nine of ten simulated worlds the error of what
differences tell is below a factor of 1.25; people who walk about look like up to 1.5. On the choosing half of the
variety 1.4 to 1.6 give the same within three worlds."""

# --- Evidence for a landmark (eval/replay/hindsight/record.py, eval/replay/hindsight/ledger.py) ---------------------

CONFIRMED = 4
"""Observations that make a landmark certain, if it is always seen; people are mostly seen two or three times as one."""
CONFIRMED_AT_LEAST = 2.0
"""Observations that make a landmark certain, however seldom landmarks in view are seen."""
JUDGED_BY = 2
"""A pairing is judged by more others than this: three coordinates of the pose are common to all of them."""
MOVED = 0.9999
"""A landmark has moved if its mean innovation is outside this probability, ..."""
RESTLESS = 0.99999
"""... or the sum of its squared innovations outside this one, 2 dof for each."""
UNLIKELY = 1e-3
"""A landmark is not there if it was missed so often in a row that this had so small a probability; ..."""
UNLIKELY_POWER = 2
"""... a certain one if it had this power of it."""
INDEPENDENT_MISSES = 2.0
"""Misses that independent ones count for, in what is known of rows of them."""
IN_VIEW_SIGMAS = 3.0
"""A landmark should be seen if so many standard deviations of its expectation are inside the field of view."""
SHADOW = math.radians(0.5)
"""rad. What is nearer and within this angle may hide a landmark."""

# --- There for good, or for a while (record.py) ---------------------------------------------------------------------

PERSISTENCE_MEANS = (0.5, 0.5, 0.2, 0.8, 0.5)
"""Each value of `Permanence` before anything is known, ..."""
PERSISTENCE_WORTH = (2.0, 2.0, 5.0, 5.0, 4.0)
"""... and how many landmarks or looks this is worth: little. Ten times as much of any changes the landmarks of two of a
hundred simulated worlds."""
PERSISTENCE_OWN = 10.0
"""Looks that the common rates are worth beside a landmark's own ones. On simulated worlds, whose landmarks are all
alike, 20 gives the same and 5 loses four of a hundred maps; on Victoria Park 5 keeps four landmarks more, 20 six
fewer."""
PERSISTENCE_CHANCE = 0.05
"""Of what is gone is read by chance so often. Fitted, it takes up what is really seen seldom (Victoria Park: 0.13)."""
PERSISTENCE_LATER_LEAST = 0.15
"""What goes goes before one look in seven at least: what is seen longer cannot be told from what stays. 0.1 to 0.25
give the same within two of a hundred maps."""
PERSISTENCE_ROUNDS = 20
"""Of expectation maximization. 40 change 17 of 7381 landmarks of 135 logs, 10 change 36."""
REASSOCIATION_GATE = 0.999
"""Probability of the gate in which readings are paired anew with the smoothed map. On the choosing half 0.99 gives as
many wrong pairings, and leaves half as many readings again unpaired that have a landmark."""
REASSOCIATION_QUANTILE = 0.9
"""Of squared distances from it, by which the noise that there is is told: the median forgets the tails, and leaves more
readings unpaired."""
REASSOCIATION_OBSERVATIONS = 4
"""A landmark read so often tells of the noise: of one read once the reading itself says where it stands."""
PERSISTENT_PROBABILITY = 2.0 / 3.0
"""A landmark is kept at the end if it stays by odds of two to one; at even odds maps of people have too many."""
PERSISTENT_FEWEST = 0.05
"""Share of kept landmarks, those with the fewest observations, that does not tell how many one needs. To CONFIRMED; 0.1
loses a map of a hundred simulated ones, and 11 landmarks of Victoria Park."""

# --- A frame without a prediction: pairs of observations on pairs of landmarks (placement.py) -------------------------

DISTANCE_SIGMAS = 3.0
"""Two distances, or a point and a landmark, agree within so many standard deviations."""
PLACE_PAIRINGS = 3
"""Pairings that a pose found by geometry needs, of a frame or of a local map."""
FRAME_POINTS = 12
"""Observations of a frame that poses are made from, the surest."""
LONG_PAIR = 0.5
"""They are paired if they are as far apart as this share of the farthest two: a short pair tells no heading."""
MOTION_GATE = 0.9999
"""Probability (3 dof) of the motion inside which poses are looked for."""
FRAME_POSES = 20_000
"""Poses that a frame may give."""
FRAME_PAIRINGS = 12
"""Different pairings that are verified; ..."""
FRAME_ALIKE = 0.5
"""... those that share more than this part of what they pair are one."""
REACH_SIGMAS = 3.0
"""Landmarks are in reach, and points were in view before, by so many standard deviations."""
VERIFY_ROUNDS = 2
"""Fits to all pairings, each followed by a look at what else can be paired."""
FIT_SLACK = 0.5
"""Pairings are verified as long as their motion, which a fit to all of them changes so much, may beat the best one."""
REMEMBERED_FRAMES = 100
"""Frames that tell what was in view before."""

# --- Local map: what was seen over a few frames (relocalize.py) -----------------------------------------------------

FADED = 1.0
"""m; a point known worse than this is left behind."""
SAME_POINT = 0.99
"""Probability inside which an observation is of a point that the local map has already."""

# --- Relocalization: a local map in the whole one, without a prior (relocalize.py) ----------------------------------

RELOCALIZE_GATE = 0.99
"""Probability of the joint distance of the fit (2 q - 3 dof for q pairings)."""
SCAN_POINTS = 12
"""Points of a local map that are used, the surest: a complete search over more takes too long."""
SCAN_SHARE = 0.7
"""Of these points must be paired."""
SCAN_ODDS = 1000.0
"""The place must be this many times as likely as any other."""
SCAN_STRAY = 0.01
"""Prior probability that a point is no landmark of the map."""
SEARCH_SLACK = 1
"""Hypotheses with so many pairings less than the best are verified, too."""
SEARCH_KEPT = 2000
"""Hypotheses that a search may hand over; a scan that fits in more ways is ambiguous."""
SEARCH_BUDGET = 3_000_000
"""Nodes that a search may visit: about half a second."""
ONE_PLACE_SIGMAS = 5.0
"""Fits that are closer than so many standard deviations are one place."""
FIT_STEPS = 5
"""Steps of Gauss and Newton, ..."""
FIT_CONVERGED = 1e-8
"""... fewer once the square of a step, by its information, is smaller than this."""
FIT_SINGULAR = 1e-9
"""A fit whose information has a smaller eigenvalue gives no pose."""

# --- Constellations: landmarks initialized twice (constellation.py) -------------------------------------------------

CONSTELLATION_FEWEST = 4
"""Landmarks that a place needs; two are laid on each other, so two more must agree."""
CONSTELLATION_VOTES = 3
"""Landmarks that a place needs to be kept for comparison."""
CONSTELLATION_LONG = 1.5
"""Two landmarks are laid on two others if they are this many tolerances apart: a short pair does not tell the turn."""
CONSTELLATION_KEPT = 200
"""Places that are compared."""
CONSTELLATION_ODDS = 100.0
"""The best place must be so many times as likely as the second, by the number of landmarks that agree with each."""
CONSTELLATION_SECOND = 2
"""Landmarks that agree with the second place at least: two can be laid on two others nearly everywhere."""
CONSTELLATION_SHARED = 1
"""Places that have no more pairs than this in common with the best one are other places."""
CHANCE_MOST, CHANCE_LEAST = 0.5, 1e-9
"""Bounds of the probability that a landmark agrees with a place by chance."""
CONSTELLATION_GATE = 0.9999
"""Probability of the joint test of all that are taken for the same."""
CONSTELLATION_ALONE = 0.999
"""Probability of each of them, given the others."""

# --- The window that is compared with the old map (duplicates.py) ---------------------------------------------------

WINDOW_SPAN = 2.0
"""In ranges: what was seen over a distance travelled as short as this is the window."""
WINDOW_AGE = 6.0
"""In ranges: what was initialized longer ago than this is old."""
WINDOW_EVERY = 5
"""Frames with observations between two looks at the window, where nothing new is initialized."""
WINDOW_OBSERVATIONS = 2
"""Observations that a landmark needs to be compared."""
WINDOW_MOST = 16
"""Landmarks of a constellation, those seen last."""
WINDOW_GATE = 0.999
"""Probability of the difference of two landmarks that may be one, in a constellation."""
TURN_SIGMAS, TURN_MARGIN = 3.0, 0.1
"""A constellation is turned by no more than so many standard deviations of the heading, and this [rad]."""
SINGLE_GATE = 0.99
"""Probability of the difference of two landmarks that may be one by themselves."""
SINGLE_CHANCE = 0.1
"""Landmarks that one expects by chance where two stand: with fewer, a single pair may be merged; ..."""
SINGLE_CHANCE_YOUNG = 0.2
"""... where the other one is not old, this share of it."""

# --- Pairing where landmarks are dense (gates.py) -------------------------------------------------------------------

DENSE = 0.5
"""Landmarks that one expects inside a gate by chance: with more, a frame alone cannot tell which is which."""
DENSE_GATE = 0.99
"""Probability of the gate of pairings that density is judged by where the setup has none."""
TOGETHER = 4
"""Pairings of one frame that tell each other which is which."""

# --- A robot moved unseen: cumulative sums (eval/replay/hindsight/lost.py, eval/replay/hindsight/kidnapping.py) -----

ALARM = 14.0
"""Score of an alarm: by Wald's inequality a healthy log raises one in exp(ALARM) frames at most."""
LOST_SHARE = 0.4
"""A lost robot in a known map pairs this share of what a healthy one pairs."""
LOST_SCALE = 4.0
"""The NIS of what it pairs is this many times the expected one."""
MISFIT_MOST = 0.5
"""Share of `ALARM` that the misfit of one frame may add: its errors are not independent."""
HEALTH_MEMORY = 1000.0
"""Observations over which the healthy share of pairings and their NIS are learned, ..."""
HEALTH_START = (0.9, 1.0)
"""... share of observations paired and NIS per degree of freedom that are expected at first, ..."""
HEALTH_WEIGHT = 50.0
"""... and the number of observations that these are worth."""
HEALTH_SHARE_LEAST, HEALTH_SHARE_MOST = 0.05, 0.99
"""Bounds of the healthy share of pairings, as the test uses it."""
HEALTH_STRAYS_LEAST = 0.01
"""Share of the observations that are unpaired in a healthy frame at least, as the test uses it."""
ELSEWHERE_SHARE = 0.2
"""A robot that is elsewhere in SLAM takes something for a landmark so much less often than one that sees it."""
ENOUGH_OPPORTUNITIES = 100
"""At certain landmarks in view, before it is known how often these are missed."""
PAIRING_TRUST = 2.0
"""What a pairing with a certain landmark takes off the score in SLAM: it may be wrong, one in e^2."""
ALARM_OBSERVATIONS = 3
"""Of one frame, for its misses to count. A single one, where more were expected, is of a sensor that is covered."""
FOUND_AGAIN = 0.1
"""In ranges: with a smaller standard deviation of its position the robot is not lost any more."""

# --- Several pose hypotheses in a known map (localizer.py) ----------------------------------------------------------

HYPOTHESIS_ITERATIONS = 10
"""Of an update of a hypothesis: far travelled without observations, the first one is far from linear."""
DECISION_WEIGHT = 0.5
"""A decision that fewer of the hypotheses share, by weight, is put off."""
OTHER_PLACE = 0.9999
"""An estimator is somewhere else if its pose is outside this probability of the hypotheses' (3 dof)."""

# --- Lost while mapping (lost.py) -----------------------------------------------------------------------------------

PAIRED_HEALTHY = 0.5
"""Share of the certain landmarks in view that are paired, of these and those that something newer is read for: a
healthy robot pairs so many of them at least, ..."""
PAIRED_LOST = 0.2
"""... and a lost one so many."""
PAIRED_ALARM = 7.0
"""Score of an alarm. By Wald's inequality there is a false one in exp(7) = 1100 frames from different places where just
half are paired, in 10^5 where 60 % are."""
RETRACTED_SHARE = 0.5
"""Share of the landmarks read often (`CONFIRMED`) that goes in the end where a robot was lost. On the choosing half of
the variety that is so on 12 worlds: on one of 68 whose RMSE is up to 1.5 times that with labels (1.49), on 11 of 31
others."""
RETRACTED_FEWEST = 4
"""Such landmarks, for their share to tell anything."""
