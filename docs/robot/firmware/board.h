/* Pins, dimensions and limits. Dimensions are those of wings/robot/packets.py; lengths are whole, see each unit. */
#ifndef BOARD_H
#define BOARD_H

/* port D: 0, 1 serial line; 2 (INT0), 3 (INT1) channel A of the left and right encoder; 4, 5 their channel B;
   6, 7 direction of the left and right motor, high: forward */
#define LEFT_A PD2
#define RIGHT_A PD3
#define LEFT_B PD4
#define RIGHT_B PD5
#define LEFT_DIRECTION PD6
#define RIGHT_DIRECTION PD7

/* port B: 0 echo of all sonars; 1 (OC1A), 2 (OC1B) PWM of the left and right motor; 3, 4 triggers of sonars 6, 7
   port C: 0 to 5 triggers of sonars 0 to 5 */
#define ECHO PB0
#define LEFT_PWM PB1
#define RIGHT_PWM PB2
#define PORT_C_SONARS 6
#define FIRST_PORT_B_TRIGGER PB3

#define SONAR_COUNT 8
#ifndef SONARS
#define SONARS 0xFF /* bit i: sonar i is there; the others send TIMEOUT_MM */
#endif
#define TIMEOUT_MM 4000
#define SLOT_MS 30   /* of a sonar: an echo from 4 m takes 23.7 ms; a round of eight 240 ms, below the period of 250 ms */
#define STUCK_MS 200 /* after which an echo line that stays high is no longer waited for */

#define TICK_NM 212712L     /* way of the rim per encoder tick: pi x 65 mm / 960 */
#define WHEEL_BASE_MM 250L  /* between the wheels */
#define FASTEST_UM_S 400000L /* of a wheel's rim */

#define STEP_MS 10       /* of the speed loop and the odometry */
#define WATCHDOG_MS 1000 /* after the last command the motors are off */
#define PATIENCE_MS 880  /* after the last command the loop brakes: 100 ms to stand, and two steps */
#define COMMAND_PAUSE_MS 50 /* of silence, after which a byte begins a command */

/* Speed loop of wings/robot/simulated.py: 4 duty per m/s are 43 of FULL_DUTY per tick per step; the integral
   adds a tenth of that per step (step over the motor's time constant of 0.1 s). */
#define FULL_DUTY 511 /* of 9 bits; 16 MHz / 2 / 511: PWM of 15.7 kHz */
#define GAIN 43L
#define INTEGRAL_PART 10L
#define FINE 256L /* parts of a tick in which the loop counts */

#endif
