#include "worlds.hpp"

#include <madrona/mw_gpu_entry.hpp>

namespace gsb {

using namespace madrona;
using namespace madrona::base;
using namespace madrona::phys;

static constexpr auto solver = PhysicsSystem::Solver::XPBD;

void World::registerTypes(ECSRegistry &registry, const Config &)
{
    base::registerTypes(registry);
    PhysicsSystem::registerTypes(registry, solver);
    registry.registerArchetype<Moving>();
    registry.registerArchetype<Fixed>();
    registry.exportColumn<Moving, Position>(uint32_t(Column::Position));
    registry.exportColumn<Moving, Rotation>(uint32_t(Column::Rotation));
    registry.exportColumn<Moving, Velocity>(uint32_t(Column::Velocity));
}

#ifdef MADRONA_GPU_MODE
// On a GPU the bodies of all worlds share a table, in the order in which worlds happened to make them.
template <typename ArchetypeT>
static TaskGraphNodeID sorted(TaskGraphBuilder &graph, Span<const TaskGraphNodeID> after)
{
    auto byWorld = graph.addToGraph<SortArchetypeNode<ArchetypeT, WorldID>>(after);
    return graph.addToGraph<ResetTmpAllocNode>({byWorld});
}
#endif

void World::setupTasks(TaskGraphManager &graphs, const Config &config)
{
    // Begin steps nothing: the first state is the scene's.
    TaskGraphBuilder &begin = graphs.init(Graph::Begin);
#ifdef MADRONA_GPU_MODE
    auto moving = sorted<Moving>(begin, {});
    sorted<Fixed>(begin, {moving});
#else
    begin.addToGraph<ResetTmpAllocNode>({});
#endif

    TaskGraphBuilder &step = graphs.init(Graph::Step);
    auto near = PhysicsSystem::setupBroadphaseTasks(step, {});
    auto stepped = PhysicsSystem::setupPhysicsStepTasks(step, {near}, config.substeps, solver);
    auto cleaned = PhysicsSystem::setupCleanupTasks(step, {stepped});
    step.addToGraph<ResetTmpAllocNode>({cleaned});
}

template <typename ArchetypeT>
static void place(Engine &ctx, const Start &start)
{
    Entity body = ctx.makeEntity<ArchetypeT>();
    ObjectID object { start.object };
    ctx.get<Position>(body) = start.position;
    ctx.get<Rotation>(body) = start.rotation;
    ctx.get<Scale>(body) = math::Diag3x3 { 1.f, 1.f, 1.f };
    ctx.get<ObjectID>(body) = object;
    ctx.get<ResponseType>(body) = start.moves ? ResponseType::Dynamic : ResponseType::Static;
    ctx.get<Velocity>(body) = start.velocity;
    ctx.get<ExternalForce>(body) = math::Vector3::zero();
    ctx.get<ExternalTorque>(body) = math::Vector3::zero();
    ctx.get<broadphase::LeafID>(body) = PhysicsSystem::registerEntity(ctx, body, object);
}

World::World(Engine &ctx, const Config &config, const Init &)
    : WorldBase(ctx)
{
    PhysicsSystem::init(
        ctx, config.objects, config.deltaT, config.substeps, config.gravity, config.bodies, solver);
    for (int32_t i = 0; i < config.bodies; i++) {
        const Start &start = config.starts[i];
        if (start.moves) {
            place<Moving>(ctx, start);
        } else {
            place<Fixed>(ctx, start);
        }
    }
}

MADRONA_BUILD_MWGPU_ENTRY(Engine, World, World::Config, World::Init);

}
