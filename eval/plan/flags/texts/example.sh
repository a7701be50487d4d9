# Without map, truth or labels: SLAM, and how well the innovations fit.
slamref convert table odometry.csv robot --observations cones.csv \
    --columns t=stamp_ms,x=pos_x,y=pos_y,theta=yaw_deg,range=dist_m,bearing=angle_deg \
    --unit time=ms,angle=deg --odometry-sigma 0.05,0.05,0.075,0.045 --observation-sigma 0.1,1deg
slamref inspect robot
slamref run robot --out report

# With the map and the true path: localization, and errors.
slamref convert table odometry.csv surveyed --observations cones.csv --map map.csv --truth truth.csv \
    --columns t=stamp_ms,x=pos_x,y=pos_y,theta=yaw_deg,range=dist_m,bearing=angle_deg,map.x=east_m,map.y=north_m \
    --unit time=ms,angle=deg --odometry-sigma 0.05,0.05,0.075,0.045 --observation-sigma 0.1,1deg \
    --prior truth --prior-sigma 0,0,0
slamref run surveyed --out report-surveyed
