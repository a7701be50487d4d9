"""Constants of `jcbb-hindsight`, in SLAM and with a known map.

Read them as `constants.NAME`. Gates are chi-square probabilities with 2 dof unless stated otherwise; "ranges" are
sensor ranges. Compiled kernels receive them as arguments, because a cached kernel does not notice a changed constant.
The odometry errors of the deciding filter (`mapper`) and the pose hypotheses (`hypotheses`) have their own.
"""

import math

from association.conditional import EXACT_VARIANCE as EXACT_VARIANCE, FREEDOM as FREEDOM, SAME_PLACE as SAME_PLACE

# --- Variance scales learned from innovations (noise.py) ------------------------------------------------------------

NOISE_MEMORY = 1000.0  # observations over which a variance scale, or the health of a robot, is learned
NOISE_PRIOR = 10.0  # weight of the stated noise at the start with a known map, in innovations
LEAST_SCALE = 0.01  # smallest variance scale

# --- Learned gates of SLAM (gates.py) -------------------------------------------------------------------------------

TAILS = 2.0  # variance of Student's t with 4 dof over its squared scale: width of the Gaussian that replaces it
SCALES_PRIOR = 3.0  # weight of the stated noise at the start of SLAM, in innovations
LEAST_SHARE = 1e-12  # smallest divisor: share of a scale in the covariance of an innovation
FALSE_REJECTION = 0.01  # target false-rejection rate of the gate
TAILS_STEP = 0.1  # largest step of the gate's logarithm for one rejected observation, ...
TAILS_HORIZON = 30.0  # ... which falls to this over the number of observations (tails of d^-4), ...
TAILS_SLOWEST = 0.03  # ... but not below this, because tails may change
SAME_GATE = 0.99  # gate inside which two observations, points or landmarks agree
AGREE = 3  # postponed observations that must agree to initialize a landmark

# --- Noise estimated from consecutive frames (noise.py) -------------------------------------------------------------

DIFFERENCES_MOST = 128  # steps used, the first of a log; twice as many add nothing
DIFFERENCES_PRIOR = 5.0  # weight of the stated noise, in pairs of observations and in steps
DIFFERENCES_ROUNDS = 40  # rounds of expectation maximization
DIFFERENCES_WIDE = 25.0  # variance of observations of moving objects over that of static ones
UNDERSTATED = 1.6
"""A sigma this many times the stated one replaces it. In nine of ten simulated worlds the estimate is within a factor
of 1.25; walking people look like up to 1.5."""

# --- Evidence for a landmark (ledger.py) ----------------------------------------------------------------------------

CONFIRMED = 4  # observations that confirm a landmark which is always detected
CONFIRMED_AT_LEAST = 2.0  # observations that confirm a landmark at any detection probability
JUDGED_BY = 2  # a pairing is judged by more others than this: three pose coordinates are common to all
MOVED = 0.9999  # a landmark moved if its mean innovation is outside this gate, ...
RESTLESS = 0.99999  # ... or the sum of its squared innovations outside this one (2 dof each)
UNLIKELY = 1e-3  # probability of a run of missed detections below which a tentative landmark is retracted
UNLIKELY_POWER = 2  # power of `UNLIKELY` for a confirmed landmark
INDEPENDENT_MISSES = 2.0  # prior weight of independent misses in the Markov chain
IN_VIEW_SIGMAS = 3.0  # standard deviations by which an expected landmark must be inside the field of view
SHADOW = math.radians(0.5)  # rad; something nearer within this angle may occlude a landmark

# --- Detection opportunities (opportunities.py) ---------------------------------------------------------------------

VIEW_RING, VIEW_SIDES = 1.35, 8  # cells of viewpoints: rings whose radii grow by this factor, and sides
SHADOW_WIDTH = 0.15  # m; half the width of a landmark that may occlude another

# --- Persistent or transient landmarks (opportunities.py) -----------------------------------------------------------

PERSISTENCE_MEANS = (0.5, 0.5, 0.4, 0.5)  # prior means of `Persistence.shares`, ...
PERSISTENCE_WORTH = (2.0, 2.0, 5.0, 10.0)  # ... and their weights, in landmarks or opportunities
RATE_MEANS = (0.5, 0.8, 0.5, 0.5)  # prior means of the detection probabilities by viewpoint, ...
RATE_WORTH = (4.0, 5.0, 4.0, 10.0)  # ... each from one landmark with so many opportunities
RATE_BOUNDS = (1e-3, 1e3)  # of the parameters of their beta distributions
PERSISTENCE_OWN = 10.0  # weight of the common rates against a landmark's own, in opportunities, before it is fitted
PERSISTENCE_CHANCE = 0.01  # detection probability of a landmark that has vanished, where nothing is smoothed
PERSISTENCE_LEAVING = 0.001  # probability that a real landmark leaves before an opportunity
PERSISTENCE_LATER_LEAST = 0.35  # smallest probability that a transient landmark vanishes before an opportunity
PERSISTENCE_ROUNDS = 20  # rounds of expectation maximization
PERSISTENT_FEWEST = 0.05  # share of the observations, of landmarks with the fewest, ignored in the required number
SMOOTHED = 3e-3
"""sigma. A shorter step ends the smoothing, as a root sum of squares over all directions. With 1e-3 all decisions in 83
logs are the same, after a tenth more steps. With 1e-2 one log's differ, with 3e-2 those of 13."""
REASSOCIATION_GATE = 0.999  # gate of the final re-association
REASSOCIATION_QUANTILE = 0.9  # quantile of squared distances that gives the variance scale: a median ignores tails
REASSOCIATION_OBSERVATIONS = 4  # observations of a landmark that counts for this scale

# --- Two landmarks of the smoothed map that are one (whole_log.py) ---------------------------------------------------

SAME_NEAREST = 3  # neighbours that a landmark is compared with
SAME_DETECTED = 0.5  # detection probability of two landmarks, if they are two
SAME_CHANCE = 0.02  # probability that one landmark is observed twice in a frame, by clutter
SAME_ODDS = 3.0  # log odds above which both are one
SAME_ROUNDS = 2  # smoothings with merged landmarks: places agree better then

# --- The floor (whole_log.py) ---------------------------------------------------------------------------------------

PLAIN_MOST = 2  # landmarks of `jcbb` over those initialized in hindsight, above which it is not followed to its end
PLAIN_ODDS = 40.0  # log odds from which the final decisions are those of `jcbb`, ...
PLAIN_LEFT = 0.1  # ... which are asked for if a larger share of the landmarks left

# --- A frame without a prediction (placement.py) --------------------------------------------------------------------

DISTANCE_SIGMAS = 3.0  # standard deviations within which two distances agree, and something is in reach or was in view
PLACE_PAIRINGS = 3  # pairings of a pose found by geometry, of a frame or of a local map
FRAME_POINTS = 12  # observations of a frame, or points of a local map, from which poses are made: the most precise ones
LONG_PAIR = 0.5  # smallest length of a pair over that of the longest: a short pair does not give the heading
MOTION_GATE = 0.9999  # gate (3 dof) of a motion inside which poses are searched; outside it two poses differ
FRAME_POSES = 20_000  # largest number of poses of a frame
FRAME_PAIRINGS = 12  # different pairings that are verified; ...
FRAME_ALIKE = 0.5  # ... those that share more than this part are one
VERIFY_ROUNDS = 2  # fits to all pairings, each followed by a search for more pairings
FIT_SLACK = 0.5  # a pairing is verified if its motion, which the fit changes by this much, may beat the best one
REMEMBERED_FRAMES = 100  # frames that define what was in view before

# --- Local map of a few frames (relocalize.py) ----------------------------------------------------------------------

FADED = 1.0  # m; points with a larger standard deviation are dropped

# --- Relocalization of a local map in the whole map (relocalize.py) -------------------------------------------------

RELOCALIZE_GATE = 0.99  # gate of the joint distance of the fit (2 q - 3 dof for q pairings)
SCAN_SHARE = 0.7  # share of these points that must be paired
SCAN_ODDS = 1000.0  # odds of the place against the second best
SCAN_STRAY = 0.01  # prior probability that a point is no landmark of the map
SEARCH_SLACK = 1  # hypotheses with this many pairings fewer than the best are verified, too
SEARCH_KEPT = 2000  # largest number of hypotheses; a scan with more is ambiguous
SEARCH_BUDGET = 3_000_000  # largest number of nodes: about half a second
ONE_PLACE_SIGMAS = 5.0  # fits closer than this many standard deviations are one place
FIT_STEPS = 5  # Gauss-Newton steps, ...
FIT_CONVERGED = 1e-8  # ... fewer once the squared step in units of its information is below this
FIT_SINGULAR = 1e-9  # smallest eigenvalue of the information of a fit

# --- Constellations: landmarks initialized twice (duplicates.py) --------------------------------------------------

CONSTELLATION_FEWEST = 4  # landmarks of an accepted alignment: two define it, two must agree
CONSTELLATION_VOTES = 3  # landmarks of an alignment that is compared
CONSTELLATION_LONG = 1.5  # smallest length of a pair in tolerances: a short pair does not give the rotation
CONSTELLATION_KEPT = 200  # alignments that are compared
CONSTELLATION_ODDS = 100.0  # odds of the best alignment against the second, by their numbers of landmarks
CONSTELLATION_SECOND = 2  # least number of the second: two landmarks can be laid on two others nearly everywhere
CONSTELLATION_SHARED = 1  # alignments with no more pairs in common with the best are different ones
CHANCE_MOST, CHANCE_LEAST = 0.5, 1e-9  # bounds of the probability that a landmark agrees by chance
CONSTELLATION_GATE = 0.9999  # gate of the joint test of all pairs
CONSTELLATION_ALONE = 0.999  # gate of each pair given the others

# --- The window compared with the old map (duplicates.py) -----------------------------------------------------------

WINDOW_SPAN = 2.0  # ranges travelled within which a landmark was seen to be in the window
WINDOW_AGE = 6.0  # ranges travelled after which a landmark is old
WINDOW_EVERY = 5  # frames with observations between two searches without new landmarks
WINDOW_OBSERVATIONS = 2  # observations of a landmark that is compared, online and at the end
WINDOW_MOST = 16  # landmarks of a constellation, those seen last
WINDOW_GATE = 0.999  # gate of the difference of two landmarks in a constellation, not below `SAME_GATE`
TURN_MARGIN = 0.1  # rad; largest rotation of a constellation beyond `DISTANCE_SIGMAS` of the heading
SINGLE_CHANCE = 0.1  # landmarks expected by chance at the place of two, below which a single pair may be merged; ...
SINGLE_CHANCE_YOUNG = 0.2  # ... share of it if the other landmark is not old

# --- Dense landmarks (gates.py) -------------------------------------------------------------------------------------

DENSE = 0.5  # landmarks expected by chance inside a gate, above which a single observation is ambiguous
DENSE_GATE = 0.99  # gate by which density is computed if the setup has none
TOGETHER = 4  # ambiguous pairings of one frame that support each other

# --- Kidnapped robot: cumulative sums (kidnapping.py, localizing_frontend.py) ---------------------------------------

ALARM = 14.0  # score of an alarm: at most one false alarm in exp(ALARM) frames (Wald's inequality)
LOST_SHARE = 0.4  # share of pairings of a lost robot over that of a healthy one, with a known map
LOST_SCALE = 4.0  # NIS of the pairings of a lost robot over the expected one
MISFIT_MOST = 0.5  # share of `ALARM` that one frame's misfit may add: its errors are not independent
HEALTH_START = (0.9, 1.0)  # prior of the healthy share of pairings and of their NIS per dof, ...
HEALTH_WEIGHT = 50.0  # ... and the weight of this prior, in observations
HEALTH_SHARE_LEAST, HEALTH_SHARE_MOST = 0.05, 0.99  # bounds of the healthy share of pairings
HEALTH_STRAYS_LEAST = 0.01  # least share of unpaired observations in a healthy frame
ELSEWHERE_SHARE = 0.2  # detection probability at a wrong place in SLAM over that at the right one
ENOUGH_OPPORTUNITIES = 100  # detection opportunities of confirmed landmarks before their rate is known
PAIRING_TRUST = 2.0  # reduction of the score by a pairing with a confirmed landmark: one in e^2 may be wrong
ALARM_OBSERVATIONS = 3  # observations of a frame whose misses count: with fewer the sensor may be covered
FOUND_AGAIN = 0.1  # ranges; with a smaller position sigma the robot is no longer lost

# --- Pose hypotheses with a known map (localizing_frontend.py) ------------------------------------------------------

HYPOTHESIS_ITERATIONS = 10  # iterations of an update: after long dead reckoning the first is far from linear
DECISION_WEIGHT = 0.5  # weight of hypotheses below which a decision is postponed

# --- Lost while mapping (kidnapping.py) -----------------------------------------------------------------------------

PAIRED_HEALTHY = 0.5  # least share of paired landmarks of a healthy robot, of those paired or replaced, ...
PAIRED_LOST = 0.2  # ... and of a lost one
PAIRED_ALARM = 7.0
"""Score of an alarm: at most one false alarm in exp(7) = 1100 frames from different places if half are paired, in 10^5
if 60 % are (Wald's inequality)."""
RETRACTED_SHARE = 0.5  # share of often observed landmarks retracted at the end, above which the map is reported as bent
RETRACTED_FEWEST = 4  # often observed landmarks needed for this report
