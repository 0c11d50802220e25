% variables of motor_pid.slx
Ts = 0.005; % s
kp = 0.5;
ki = 3;
