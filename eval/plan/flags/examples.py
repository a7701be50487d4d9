"""An example of every flag, shown at the end of `--help`."""

from __future__ import annotations

PROG = "python -m eval.run_all"
EPILOG = """\
examples:
  python -m eval.run_all                                    the default report, in results/report
  python -m eval.run_all --quick                            the same, shortened (a check that all works)
  python -m eval.run_all --log my_log --log arena:3         an open log folder and a simulated log
  python -m eval.run_all --log intel.log.gz --keyframe-distance 0.8    a laser log (CARMEN): scans matched, loops closed
  python -m eval.run_all --log intel.log.gz --least-information 0.2    its graph without the key poses that tell little
  python -m eval.run_all --log victoria-park --task slam    one log, one task
  python -m eval.run_all --log visual:0                     a rendered camera log: pictures found, corners used
  python -m eval.run_all --log my_lab_folder --camera-translation m --camera-reading to-body --trust-pickle
  python -m eval.run_all --log visual:0:frames=40 --corner-noise depth
  python -m eval.run_all --log corridor:0:people+range=8    the corridor lab: people in the way, any constant changed
  python -m eval.run_all --log intel.log.gz --relations intel.relations.csv    a CARMEN laser log, scored by relations
  python -m eval.run_all --lab corridor:3                   the corridor lab as a whole: its six questions answered
  python -m eval.run_all --lab corridor:3+srho=0.05 --write-up     with another sensor, and a text to hand in
  python -m eval.run_all --lab corridor:3 --lab-text        each run's steps as the lab's program prints them
  python -m eval.run_all --lab visual:0                     the visual lab: its three questions
  python -m eval.run_all --lab visual:0 --ellipses auto     the plan's ellipses as large as is needed to see them
  python -m eval.run_all --data ~/datasets                  every dataset found in a folder, two levels deep
  python -m eval.run_all --log my_log --estimator ekf,batch-cauchy --association known
  python -m eval.run_all --log arena:0 --task slam --estimator ekf,ekf-invariant,isam2,batch
  python -m eval.run_all --log arena:0 --estimator ekf,mine=./mine.py:Filter --association known,./mine.py:nearest
                                                            your own beside ours (docs/extending.md)
  python -m eval.run_all --log my_log --twins 100           trust without ground truth: p values, and whose fault it is
  python -m eval.run_all --log my_log --calibrate           its odometry errs: estimate how, beside path and map
  python -m eval.run_all --log arena:0:curvature=0.02 --calibrate curvature,scale=0.05
  python -m eval.run_all --log my_log --gate-known 0.999    leave labelled readings out that fit badly, or keep them
  python -m eval.run_all --log my_log --gate-known none     all, which is the default where no sensor read the labels
  python -m eval.run_all --log my_log --gate-known 0.9999 --no-gate-smoothers    the smoothers keep them
  python -m eval.run_all --log my_log --task slam --association known,nn,jcbb    unknown labels beside known ones
  python -m eval.run_all --log corridor:0 --association jcbb --gate 0.95 --new-gate 0.999
  python -m eval.run_all --log my_log --association ml --gate none   no gate: every reading is paired
  python -m eval.run_all --log my_log --association nn --in-view     the EKF, too, offers only what may be in view
  python -m eval.run_all --log corridor:0:people --association jcbb --maintain    drop landmarks seen only once
  python -m eval.run_all --log victoria-park --estimator ekf --forget-after 60
  python -m eval.run_all --log victoria-park --estimator ekf --deactivate-after 60
  python -m eval.run_all --full                             every method with every estimator; takes minutes
  python -m eval.run_all --runs 100 --seed 1000 --jobs 2    the consistency study: 100 arenas, two processes
  python -m eval.run_all --scenario circle --runs 100       a published study: ours beside the printed numbers
  python -m eval.run_all --scenario my_world.toml --estimator ekf,ekf-fej,batch
  python -m eval.run_all --scenario all --data DIR          every shipped scenario; DIR: the recording of esde-replay
  python -m eval.run_all --scenario trust --jobs 2           is what a log says about itself to be trusted? an hour
  python -m eval.run_all --scenario arena --runs 1000 --scheduler tcp://host:8786    on a Dask cluster
  python -m eval.run_all --log arena:0 --estimator isam2,fixed-lag --lag 20
  python -m eval.run_all --formats csv,tex --out results/paper --no-plots
  python -m eval.run_all --log my_log --result mine=est.tum --cov est.cov      your result beside ours, same tables
  python -m eval.run_all --log my_log --result a=a.tum --result b=bag:/odom --align se2 --cov-frame b=world
  python -m eval.run_all --truth gt.tum --truth-gap 0.2 --result a=a.csv     a truth alone: a referee for results
  python -m eval.run_all --truth gt.txt --result a=kitti.txt --times times.txt --axes camera    KITTI poses
  python -m eval.run_all --log arena:0 --table-width column --columns rmse_position_m,nees_pose,nis
  python -m eval.run_all --log arena:0 --figure-width 3.4in --font Times --font-size 8    figures for a column
  python -m eval.run_all --log arena:0 --figure-width 86mm --usetex --pgf      text set by LaTeX, which must be there
  python -m eval.run_all --log arena:0 --animate            a film of each estimator and association
  python -m eval.run_all --log victoria-park --estimator ekf --animate --speed 20    at 20 times real time
  python -m eval.run_all --config my_run.toml -v            the same keys from a file; flags win; a table
                                                            [corridor] (seed, people, range, ...) is a log, too
  python -m eval.run_all --log DIR --config tutorial-step1 --config tutorial-step3   (DIR made by data.convert mrclam)
  python -m eval.run_all -q                                 print nothing but errors

exit status: 0 fine, 1 an estimator that is declared consistent was rejected, 2 wrong usage or bad data"""
