// A simulated robot as the drive side and Python see it: numbers in, numbers out, one tick at a time.
#pragma once

namespace hd_sim {

// The face that Python sees, whatever the number of joints.
class World {
  public:
    virtual ~World() = default;
    virtual void write_state(double* flat) const = 0;
    virtual void read_state(const double* flat) = 0;
    virtual void start(const double* pose, const double* torque, bool motor_side) = 0;
    virtual void latch(const double* command) = 0;
    virtual void advance() = 0;
    virtual void sample(double* flat) = 0;
    virtual void truth(double* flat) = 0;
    virtual void brake(bool engage) = 0;
    virtual void external(const double* joint_torque, const double* motor_torque) = 0;
    virtual void accelerate(const double* q, const double* w, const double* torque, const double* armature,
                            double* acceleration, double* inertia, double* bias) = 0;
};

constexpr const char* kWorldCapsule = "hd_sim.World";

}  // namespace hd_sim
