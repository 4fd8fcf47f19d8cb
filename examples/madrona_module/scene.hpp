// A scene in plain C++: what the module reads of the recorder's JSON, in SI units, float32.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace gsb {

enum class Shape { Box, Sphere, Plane };

struct Body {
    std::string name;
    Shape shape;
    std::array<float, 3> edges;  // of a box [m]
    float radius;                // of a sphere [m]
    float mass;                  // [kg]; 0: the body never moves
    float staticFriction;
    float kineticFriction;
    std::array<float, 3> position;     // of the centre [m]
    std::array<float, 4> orientation;  // wxyz
    std::array<float, 3> linear;       // [m/s]
    std::array<float, 3> angular;      // in the world frame [rad/s]

    bool moves() const { return mass > 0; }
};

struct Scene {
    std::vector<Body> bodies;
    std::array<float, 3> gravity;  // [m/s2]
};

struct Settings {
    bool cuda;
    int gpu;
    uint32_t worlds;
    float deltaT;      // of a step [s]
    int32_t substeps;  // of a step
};

}
