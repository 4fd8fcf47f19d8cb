#include "simulation.hpp"

#include "worlds.hpp"

#include <madrona/mw_cpu.hpp>
#include <madrona/physics_loader.hpp>

#ifdef MADRONA_CUDA_SUPPORT
#include <madrona/cuda_utils.hpp>
#include <madrona/mw_gpu.hpp>
#endif

#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <tuple>

namespace gsb {

using namespace madrona;
using namespace madrona::phys;

namespace {

math::Vector3 vector(const std::array<float, 3> &v)
{
    return { v[0], v[1], v[2] };
}

// Bodies of the same shape, mass and friction are one object of Madrona's.
auto kindOf(const Body &body)
{
    return std::tie(body.shape, body.edges, body.radius, body.mass, body.staticFriction, body.kineticFriction);
}

struct Objects {
    std::vector<const Body *> kinds;
    std::vector<int32_t> ofBody;  // the row in `kinds` of each body

    explicit Objects(const Scene &scene)
    {
        for (const Body &body : scene.bodies) {
            auto same = [&](const Body *kind) { return kindOf(*kind) == kindOf(body); };
            auto found = std::find_if(kinds.begin(), kinds.end(), same);
            ofBody.push_back(int32_t(found - kinds.begin()));
            if (found == kinds.end()) {
                kinds.push_back(&body);
            }
        }
    }
};

// Eight corners and six faces, each counterclockwise seen from outside; bit i of a corner's number is its side on axis i.
struct Hull {
    math::Vector3 corners[8];
    uint32_t faces[24] { 0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5 };
    uint32_t sides[6] { 4, 4, 4, 4, 4, 4 };

    explicit Hull(const std::array<float, 3> &edges)
    {
        auto side = [&](int corner, int axis) { return (corner >> axis & 1 ? 0.5f : -0.5f) * edges[axis]; };
        for (int i = 0; i < 8; i++) {
            corners[i] = { side(i, 0), side(i, 1), side(i, 2) };
        }
    }

    imp::SourceMesh mesh()
    {
        imp::SourceMesh mesh {};
        mesh.positions = corners;
        mesh.indices = faces;
        mesh.faceCounts = sides;
        mesh.numVertices = 8;
        mesh.numFaces = 6;
        return mesh;
    }
};

// About the principal axes of a uniform solid; zero for a body that does not move.
math::Vector3 inverseInertia(const Body &body)
{
    if (!body.moves()) {
        return math::Vector3::zero();
    }
    if (body.shape == Shape::Sphere) {
        float inverse = 2.5f / (body.mass * body.radius * body.radius);
        return { inverse, inverse, inverse };
    }
    float x = body.edges[0] * body.edges[0], y = body.edges[1] * body.edges[1], z = body.edges[2] * body.edges[2];
    float twelfth = 12.f / body.mass;
    return { twelfth / (y + z), twelfth / (x + z), twelfth / (x + y) };
}

SourceCollisionPrimitive primitiveOf(const Body &body, uint32_t hull)
{
    SourceCollisionPrimitive primitive {};
    switch (body.shape) {
    case Shape::Box:
        primitive.type = CollisionPrimitive::Type::Hull;
        primitive.hullInput = { .hullIDX = hull };
        break;
    case Shape::Sphere:
        primitive.type = CollisionPrimitive::Type::Sphere;
        primitive.sphere = { .radius = body.radius };
        break;
    case Shape::Plane:
        primitive.type = CollisionPrimitive::Type::Plane;
        primitive.plane = {};
        break;
    }
    return primitive;
}

void load(PhysicsLoader &loader, const std::vector<const Body *> &kinds)
{
    std::vector<Hull> hulls;
    std::vector<SourceCollisionPrimitive> primitives;
    for (const Body *kind : kinds) {
        primitives.push_back(primitiveOf(*kind, uint32_t(hulls.size())));
        if (kind->shape == Shape::Box) {
            hulls.emplace_back(kind->edges);
        }
    }
    std::vector<imp::SourceMesh> meshes;
    for (Hull &hull : hulls) {  // not before: meshes point into hulls
        meshes.push_back(hull.mesh());
    }
    std::vector<SourceCollisionObject> sources;
    for (size_t i = 0; i < kinds.size(); i++) {
        sources.push_back({
            .prims = Span<const SourceCollisionPrimitive>(&primitives[i], 1),
            .invMass = kinds[i]->moves() ? 1.f / kinds[i]->mass : 0.f,
            .friction = { .muS = kinds[i]->staticFriction, .muD = kinds[i]->kineticFriction },
        });
    }
    StackAlloc scratch;
    RigidBodyAssets assets;
    CountT bytes;
    void *memory = RigidBodyAssets::processRigidBodyAssets(
        Span<const imp::SourceMesh>(meshes.data(), CountT(meshes.size())),
        Span<const SourceCollisionObject>(sources.data(), CountT(sources.size())), false, scratch, &assets, &bytes);
    if (memory == nullptr) {
        throw std::invalid_argument("Madrona makes no convex hull of a box of this scene");
    }
    for (size_t i = 0; i < kinds.size(); i++) {
        // Madrona sums over triangles and gives spheres another inertia; ours is that of the scene's solids.
        assets.metadatas[i].mass.invInertiaTensor = inverseInertia(*kinds[i]);
    }
    loader.loadRigidBodies(assets);
    free(memory);
}

// What the executors point into; it outlives them.
struct Assets {
    Objects objects;
    PhysicsLoader loader;
    std::vector<Start> starts;

    Assets(const Scene &scene, ExecMode mode)
        : objects(scene), loader(mode, CountT(objects.kinds.size()))
    {
        load(loader, objects.kinds);
        for (size_t i = 0; i < scene.bodies.size(); i++) {
            const Body &body = scene.bodies[i];
            const auto &q = body.orientation;
            starts.push_back({
                .position = vector(body.position),
                .rotation = { q[0], q[1], q[2], q[3] },
                .velocity = { .linear = vector(body.linear), .angular = vector(body.angular) },
                .object = objects.ofBody[i],
                .moves = body.moves(),
            });
        }
    }

    World::Config config(const Scene &scene, const Settings &settings, const Start *onDevice)
    {
        return {
            .objects = &loader.getObjectManager(),
            .starts = onDevice,
            .bodies = int32_t(starts.size()),
            .substeps = settings.substeps,
            .deltaT = settings.deltaT,
            .gravity = vector(scene.gravity),
        };
    }
};

}

struct Simulation::Device {
    virtual ~Device() = default;
    virtual void step() = 0;
    virtual float *column(Column column) const = 0;
};

namespace {

struct CPU final : Simulation::Device {
    using Executor = TaskGraphExecutor<Engine, World, World::Config, World::Init>;

    Assets assets;
    std::vector<World::Init> inits;
    Executor executor;

    CPU(const Scene &scene, const Settings &settings)
        : assets(scene, ExecMode::CPU), inits(settings.worlds),
          executor({ .numWorlds = settings.worlds, .numExportedBuffers = uint32_t(Column::Count) },
                   assets.config(scene, settings, assets.starts.data()), inits.data(), CountT(Graph::Count))
    {}

    void step() override { executor.runTaskGraph(Graph::Step); }

    float *column(Column column) const override
    {
        return static_cast<float *>(executor.getExported(CountT(column)));
    }
};

#ifdef MADRONA_CUDA_SUPPORT
struct GPU final : Simulation::Device {
    CUcontext context;
    Assets assets;
    Start *starts;  // on the GPU
    std::vector<World::Init> inits;
    World::Config config;
    MWCudaExecutor executor;
    MWCudaLaunchGraph stepGraph;

    GPU(const Scene &scene, const Settings &settings)
        : context(begun(settings.gpu)), assets(scene, ExecMode::CUDA),
          starts(static_cast<Start *>(cu::allocGPU(sizeof(Start) * assets.starts.size()))), inits(settings.worlds)
    {
        REQ_CUDA(cudaMemcpy(
            starts, assets.starts.data(), sizeof(Start) * assets.starts.size(), cudaMemcpyHostToDevice));
        config = assets.config(scene, settings, starts);
        executor = MWCudaExecutor(
            {
                .worldInitPtr = inits.data(),
                .numWorldInitBytes = sizeof(World::Init),
                .userConfigPtr = &config,
                .numUserConfigBytes = sizeof(World::Config),
                .numWorldDataBytes = sizeof(World),
                .worldDataAlignment = alignof(World),
                .numWorlds = settings.worlds,
                .numTaskGraphs = uint32_t(Graph::Count),
                .numExportedBuffers = uint32_t(Column::Count),
            },
            { { GSB_GPU_SOURCES }, { GSB_GPU_FLAGS }, CompileConfig::OptMode::LTO }, context);
        MWCudaLaunchGraph begin = executor.buildLaunchGraph(Graph::Begin);
        executor.run(begin);
        stepGraph = executor.buildLaunchGraph(Graph::Step);
    }

    ~GPU() override { cu::deallocGPU(starts); }

    // The size of the device's heap can be set once in a process, before a kernel that allocates is loaded.
    static CUcontext begun(int gpu)
    {
        CUcontext context = MWCudaExecutor::initCUDA(gpu);
        setenv("MADRONA_DISABLE_CUDA_HEAP_SIZE", "1", 1);
        return context;
    }

    void step() override { executor.run(stepGraph); }

    float *column(Column column) const override
    {
        return static_cast<float *>(executor.getExported(CountT(column)));
    }
};
#endif

}

Simulation::Simulation(const Scene &scene, const Settings &settings)
{
    if (!settings.cuda) {
        device_ = std::make_unique<CPU>(scene, settings);
        return;
    }
#ifdef MADRONA_CUDA_SUPPORT
    device_ = std::make_unique<GPU>(scene, settings);
#else
    throw std::invalid_argument("this module was built without CUDA");
#endif
}

Simulation::~Simulation() = default;

void Simulation::step()
{
    device_->step();
}

float *Simulation::positions() const
{
    return device_->column(Column::Position);
}

float *Simulation::rotations() const
{
    return device_->column(Column::Rotation);
}

float *Simulation::velocities() const
{
    return device_->column(Column::Velocity);
}

}
